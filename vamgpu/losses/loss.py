"""What a loss is, and how losses compose: sums, factors, powers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf
from typing import Any, ClassVar, Self

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.kernels.pointwise import disc
from vamgpu.kernels.signature import Kernel
from vamgpu.kernels.update import multiply
from vamgpu.losses.response import REACH
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import EVERYWHERE, SUM, all_folded, parts_for

DOSES = 257  # number of doses in the search for the curvature
SINGLE = "an endless web cannot have weights of single voxels; use penalty or gain for inside and outside"


class Loss(ABC):
    """A scalar function of the dose to minimize, with its gradient.

    Losses can be added (``a + b``), multiplied by factors ≥ 0 (``0.1 * a``) and raised to powers (``a ** 0.5``). Your
    own loss is a `VoxelLoss`, written in NumPy, or a subclass with `value_and_gradient`.
    """

    @property
    def coupling(self) -> str:
        """Reason why the derivative of a voxel depends on other voxels.

        Empty for a sum over voxels, each with its own loss; such a loss can be minimized segment by segment.
        """
        return f"{type(self).__name__} is not declared as a sum over voxels; define its coupling as empty if it is one"

    @abstractmethod
    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        """The loss of a dose, on its device.

        Args:
            dose: Dose relative to the part's, [x, y, z]; unchanged unless it is also ``out``.
            target: Fractions [x, y, z].
            out: Array for the derivative with respect to dose, [x, y, z]; may be ``dose``.
            reach: Radius about the axis [voxels] beyond which voxels do not count: their derivative is 0.

        Returns:
            The loss.
        """

    def curvature(self) -> float:
        """Largest second derivative of a voxel's loss by its dose, which limits the length of steps.

        Returns:
            The curvature of the loss.

        Raises:
            BadInput: The curvature is not defined.
        """
        raise BadInput(f"{self!r} has no curvature, which the steps along a web need; define curvature()")

    def on(self, field: Callable[[Any], DeviceArray | None]) -> Loss:
        """The same loss with its voxel weights on a device.

        Args:
            field: Function that makes a field [x, y, z] on the device from an array.

        Returns:
            The loss.
        """
        return self

    def weighted(self, weight: DeviceArray) -> Loss:
        """The same loss with every voxel's share multiplied by a weight.

        Args:
            weight: Weight of every voxel ≥ 0, [x, y, z] on the dose's device.

        Returns:
            The loss.

        Raises:
            BadInput: The loss does not support weights.
        """
        raise BadInput(f"{type(self).__name__} does not support voxel weights, but the bodies of the target have "
                       "some; give them the weight 1, or define weighted()")  # fmt: skip

    def __add__(self, other: Loss) -> Loss:
        return Sum((*_terms(self), *_terms(other)))

    def __mul__(self, factor: float) -> Loss:
        return Power(self, 1.0, factor)

    __rmul__ = __mul__

    def __pow__(self, exponent: float) -> Loss:
        return Power(self, exponent)


class KernelLoss(Loss):
    """A sum over voxels that one kernel computes; the dataclass has a field ``weight``, the weight of each voxel."""

    weight: Any
    sums: ClassVar[tuple[str, ...]] = ("parts",)  # the kernel's partial results, the loss first

    @abstractmethod
    def launched(self, device: Device) -> tuple[Kernel, dict[str, Any]]:
        """Name the kernel that computes the loss.

        Args:
            device: Device of the loss.

        Returns:
            The kernel, and its arguments besides dose, target, weight, reach and sums.
        """

    @property
    def coupling(self) -> str:
        return "" if self.weight is None else SINGLE

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        if out is not dose:
            combine(1.0, dose, 0.0, dose, out)
        return self.passed(out, target, reach)[0]

    def passed(self, dose: DeviceArray, target: DeviceArray, reach: float, **more: Any) -> list[float]:
        """The kernel's sums, with ``more`` in place of what `launched` gives; the dose becomes the derivative."""
        kernel, given = self.launched(dose.device)
        tables = {name: parts_for(kernel, dose) for name in self.sums}
        given |= {"weight": target, "weighted": 0} if self.weight is None else {"weight": self.weight, "weighted": 1}
        dose.device.launch(kernel, dose=dose, target=target, reach=reach, **(given | more), **tables)
        return all_folded((table, SUM) for table in tables.values())

    def weighted(self, weight: DeviceArray) -> Self:
        both = weight
        if self.weight is not None:
            both = weight.device.empty(weight.shape)
            weight.device.launch(multiply, x=self.weight, y=weight, out=both)
        return replace(self, weight=both)  # pyright: ignore[reportArgumentType] - subclasses are dataclasses

    def on(self, field: Callable[[Any], DeviceArray | None]) -> Self:
        if self.weight is None:
            return self
        return replace(self, weight=field(self.weight))  # pyright: ignore[reportArgumentType] - subclasses are dataclasses


@dataclass(frozen=True)
class Sum(Loss):
    """Sum of losses; needs one additional volume, and another if ``out`` is the dose."""

    terms: tuple[Loss, ...]

    @property
    def coupling(self) -> str:
        return next((term.coupling for term in self.terms if term.coupling), "")

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        given = combine(1.0, dose, 0.0, dose, dose.device.empty(dose.shape)) if out is dose else dose
        value, part = self.terms[0].value_and_gradient(given, target, out, reach), dose.device.empty(dose.shape)
        for term in self.terms[1:]:
            value += term.value_and_gradient(given, target, part, reach)
            combine(1.0, out, 1.0, part, out)
        return value

    def curvature(self) -> float:
        return sum(term.curvature() for term in self.terms)

    def on(self, field: Callable[[Any], DeviceArray | None]) -> Loss:
        return replace(self, terms=tuple(term.on(field) for term in self.terms))

    def weighted(self, weight: DeviceArray) -> Loss:
        return replace(self, terms=tuple(term.weighted(weight) for term in self.terms))


@dataclass(frozen=True)
class _Around(Loss):
    """A function of the value of one loss, whose weights are those of that loss."""

    loss: Loss

    def on(self, field: Callable[[Any], DeviceArray | None]) -> Self:
        return replace(self, loss=self.loss.on(field))

    def weighted(self, weight: DeviceArray) -> Self:
        return replace(self, loss=self.loss.weighted(weight))


@dataclass(frozen=True)
class Power(_Around):
    """factor·loss^exponent, for a loss that is never negative unless the exponent is 1. Raises `BadInput`."""

    exponent: float
    factor: float = 1.0

    def __post_init__(self) -> None:
        if not (0.0 < self.exponent < inf and 0.0 <= self.factor < inf):
            raise BadInput(f"{self!r}: expected an exponent > 0 and a factor ≥ 0, both finite")

    @property
    def coupling(self) -> str:
        return self.loss.coupling or ("" if self.exponent == 1.0 else "a power of a sum couples all of its voxels")

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        value = self.loss.value_and_gradient(dose, target, out, reach)
        plain = self.exponent == 1.0 or value <= 0.0  # where the loss is 0 so is its gradient
        outer = self.factor * (1.0 if plain else self.exponent * value ** (self.exponent - 1.0))
        combine(outer, out, 0.0, out, out)
        return self.factor * (value if plain else value**self.exponent)

    def curvature(self) -> float:
        return self.factor * self.loss.curvature()


@dataclass(frozen=True)
class Mean(_Around):
    """A loss divided by the number of voxels that count, which makes it independent of that number.

    Args:
        loss: A sum over voxels.
    """

    @property
    def coupling(self) -> str:
        return self.loss.coupling or "a mean is over all voxels of a web"

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        nx, ny, nz = dose.shape
        share = 1.0 / max(1.0, float(np.count_nonzero(disc(nx, ny, reach))) * nz)
        value = self.loss.value_and_gradient(dose, target, out, reach)
        combine(share, out, 0.0, out, out)
        return share * value


def steepest(loss: Callable[[np.ndarray], np.ndarray], least: float = 0.0, most: float = REACH) -> float:
    """Largest second derivative of a function for doses from ``least`` to ``most``."""
    dose = np.linspace(least, most, DOSES)
    return float(np.abs(np.gradient(np.gradient(loss(dose), dose), dose)).max())


def _terms(loss: Loss) -> tuple[Loss, ...]:
    return loss.terms if isinstance(loss, Sum) else (loss,)
