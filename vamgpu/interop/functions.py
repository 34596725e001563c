"""Differentiable functions: values on a device, and their vector–Jacobian products."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.backend.host_memory import to_read
from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.errors import BadInput
from vamgpu.methods.joint.models import KineticModel, LinearModel, Pair
from vamgpu.operators.compose import combine
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.space import Space


class Differentiable(ABC):
    """A function of fields with its vector-Jacobian product; subclasses become functions of PyTorch and JAX.

    Attributes:
        device: The device of its arrays.
        spaces: Spaces of its inputs, one each.
        space: Space of its value.
    """

    device: Device
    spaces: tuple[Space, ...]
    space: Space

    @abstractmethod
    def value(self, *inputs: DeviceArray) -> DeviceArray:
        """Compute the function.

        Args:
            inputs: Fields [space.shape] of its spaces; they do not change.

        Returns:
            The value, [space.shape].
        """

    @abstractmethod
    def slopes(self, inputs: Sequence[DeviceArray], slope: DeviceArray) -> Sequence[DeviceArray]:
        """Compute derivatives with respect to the inputs.

        Args:
            inputs: Point at which to differentiate, each [space.shape].
            slope: Derivative of a number by the value, [space.shape]; it does not change.

        Returns:
            Derivatives of that number by each input, [space.shape].
        """


class Linear(Differentiable):
    """An operator; its transpose is its vector-Jacobian product at every point."""

    def __init__(self, operator: LinearOperator) -> None:
        self.operator: LinearOperator = operator
        self.device: Device = operator.device
        self.spaces: tuple[Space, ...] = (operator.domain,)
        self.space: Space = operator.range

    @property
    def transposed(self) -> Linear:
        """The linear function that gives the derivatives."""
        return Linear(self.operator.T)

    def value(self, *inputs: DeviceArray) -> DeviceArray:
        return self.operator(inputs[0])

    def slopes(self, inputs: Sequence[DeviceArray], slope: DeviceArray) -> Sequence[DeviceArray]:
        return (self.operator.T(slope),)


class Kinetics(Differentiable):
    """Effective dose of visible and ultraviolet light, by the adjoint of the kinetics."""

    # Derivatives expose the light again, because a model stores only the states of the last light.

    def __init__(self, model: KineticModel | LinearModel) -> None:
        visible, ultraviolet = model.operators
        self.model: KineticModel | LinearModel = model
        self.device: Device = visible.device
        self.spaces: tuple[Space, ...] = (visible.range, ultraviolet.range)
        self.space: Space = visible.domain

    def value(self, *inputs: DeviceArray) -> DeviceArray:
        return self.model.expose(Pair(*inputs))

    def slopes(self, inputs: Sequence[DeviceArray], slope: DeviceArray) -> Sequence[DeviceArray]:
        self.model.expose(Pair(*inputs))
        return self.model.gradient(combine(1.0, slope, 0.0, slope, self.device.empty(slope.shape)))


class OxygenDose(Differentiable):
    """Effective dose of patterns in a resin with oxygen; derivatives expose the patterns again."""

    def __init__(self, model: OxygenModel) -> None:
        self.model: OxygenModel = model
        self.device: Device = model.device
        self.spaces: tuple[Space, ...] = (model.range,)
        self.space: Space = model.domain

    def value(self, *inputs: DeviceArray) -> DeviceArray:
        return self.model.T(inputs[0])

    def slopes(self, inputs: Sequence[DeviceArray], slope: DeviceArray) -> Sequence[DeviceArray]:
        self.model.T(inputs[0])
        return (self.model(slope),)


def function_of(what: Any) -> Differentiable:
    """The differentiable function of an operator or a model.

    Args:
        what: An operator, a model of kinetics, or a `Differentiable`.

    Returns:
        The function.

    Raises:
        BadInput: It is none of these.
    """
    if isinstance(what, Differentiable):
        return what
    if isinstance(what, OxygenModel):
        return OxygenDose(what)
    if isinstance(what, LinearOperator):
        return Linear(what)
    if isinstance(what, (KineticModel, LinearModel)):
        return Kinetics(what)
    raise BadInput(
        f"got {what!r}; expected an operator, a KineticModel, a LinearModel or a vamgpu.interop.Differentiable"
    )


def sent(device: Device, values: np.ndarray) -> DeviceArray:
    """A field from an array on the host; shares memory if device and host do."""
    real = np.asarray(values, device.real)
    return device.upload(real) if device.is_gpu else device.field(device.adopt(to_read(real)))
