"""Differentiable functions and losses for PyTorch; CUDA tensors stay on a GPU that Warp also uses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # types are also checked without PyTorch
    torch: Any = None
    once_differentiable: Any = None
    Tensor = Any
else:
    try:
        import torch
    except ImportError as _error:
        raise ImportError("vamgpu.interop.torch needs PyTorch: pip install vamgpu[torch]") from _error
    from torch import Tensor
    from torch.autograd.function import once_differentiable

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.interop.functions import Differentiable, Linear, function_of, sent
from vamgpu.losses.loss import Loss
from vamgpu.operators.reductions import EVERYWHERE
from vamgpu.operators.space import require


def differentiable(what: Any) -> Callable[..., Tensor]:
    """A function of tensors that `torch.autograd` differentiates by exact transposes.

    Args:
        what: An operator, `ProofDose`, a `KineticModel`, or any `Differentiable`. Linear functions can be
            differentiated any number of times, others once.

    Returns:
        A function of one tensor for each input, whose value has the type and the device of the first.

    Raises:
        BadInput: ``what`` is none of these.
    """
    function = function_of(what)
    kind = _Applied if isinstance(function, Linear) else _Evaluated
    return lambda *inputs: kind.apply(function, *inputs)


def to_device(device: Device, tensor: Tensor) -> DeviceArray:
    """A tensor [major, minor, z], anywhere, as a field; shares memory if possible."""
    given = tensor.detach()
    if given.is_cuda and tuple(map(int, given.__dlpack_device__())) == device.dlpack_device:
        return device.field(given.to(torch.float32).contiguous())
    return sent(device, given.cpu().numpy())


def to_tensor(array: DeviceArray, like: Tensor) -> Tensor:
    """A field as a tensor of the type and device of ``like``; memory of a GPU is shared or copied there."""
    found = torch.from_numpy(array.numpy()) if not _on_gpu(array.device) else torch.from_dlpack(array)
    return found.to(like.device, like.dtype)


def _on_gpu(device: Device) -> bool:
    return device.dlpack_device[0] != 1


def _received(function: Differentiable, inputs: tuple[Tensor, ...]) -> list[DeviceArray]:
    if len(inputs) != len(function.spaces):
        raise BadInput(f"got {len(inputs)} tensors; expected {len(function.spaces)}")
    for space, tensor in zip(function.spaces, inputs, strict=True):
        require(space, tensor, "the tensor")
        if not tensor.is_floating_point():
            raise BadInput(f"the tensor holds {tensor.dtype}; expected floating-point numbers: tensor.float()")
    return [to_device(function.device, tensor) for tensor in inputs]


class _Applied(torch.autograd.Function):
    """A linear function; its derivatives are linear, so they are also differentiable."""

    @staticmethod
    def forward(ctx: Any, function: Linear, *inputs: Tensor) -> Tensor:
        ctx.function = function
        return to_tensor(function.value(*_received(function, inputs)), inputs[0])

    @staticmethod
    def backward(ctx: Any, *slopes: Any) -> Any:
        return None, _Applied.apply(ctx.function.transposed, slopes[0])


class _Evaluated(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, function: Differentiable, *inputs: Tensor) -> Tensor:
        ctx.function = function
        ctx.save_for_backward(*inputs)
        return to_tensor(function.value(*_received(function, inputs)), inputs[0])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *slopes: Any) -> Any:
        function, inputs = ctx.function, ctx.saved_tensors
        found = function.slopes(_received(function, inputs), to_device(function.device, slopes[0]))
        return None, *(to_tensor(slope, tensor) for slope, tensor in zip(found, inputs, strict=True))


@dataclass(frozen=True)
class TensorLoss(Loss):
    """A loss written in PyTorch, which `optimize` minimizes.

    Args:
        function: Takes the dose and the target, tensors [x, y, z] relative to the part's dose, and returns a number.
            Voxels that do not count are 0 in both.
    """

    function: Callable[[Tensor, Tensor], Tensor] = field(compare=False)

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        device = dose.device
        real = torch.from_numpy(np.zeros(0, device.real))
        like = real.to(f"cuda:{device.dlpack_device[1]}") if _on_gpu(device) else real
        x, y = (torch.arange(n, device=like.device) - 0.5 * (n - 1) for n in dose.shape[:2])
        counted = (x[:, None] ** 2 + y[None, :] ** 2 <= reach**2)[:, :, None]
        given = torch.where(counted, to_tensor(dose, like), 0.0).requires_grad_()
        loss = self.function(given, torch.where(counted, to_tensor(target, like), 0.0))
        (slope,) = torch.autograd.grad(loss, given)
        device.put(to_device(device, slope * counted), out)
        device.synchronize()  # before the tensor is freed
        return float(loss.detach())
