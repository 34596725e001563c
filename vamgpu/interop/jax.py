"""Differentiable functions of JAX: through `custom_vjp` and `pure_callback`, so arrays pass through the host."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

try:
    import jax
except ImportError as _error:
    raise ImportError("vamgpu.interop.jax needs JAX: pip install vamgpu[jax]") from _error

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.interop.functions import Differentiable, Linear, function_of, sent
from vamgpu.operators.space import Space, require


def differentiable(what: Any) -> Callable[..., jax.Array]:
    """A function of arrays that `jax.grad` differentiates by exact transposes; works under ``jit`` and ``vmap``.

    Args:
        what: An operator, `ProofDose`, a `KineticModel`, or any `Differentiable`. Linear functions can be
            differentiated backwards any number of times, others once.

    Returns:
        A function of one array for each input, whose value has the type of the first.

    Raises:
        BadInput: ``what`` is none of these.
    """
    function = function_of(what)

    def value(*inputs: Any) -> Any:
        _check(function, inputs)
        return _called(lambda *given: function.value(*given), function, (function.space,), inputs)[0]

    def slopes(inputs: tuple[Any, ...], slope: Any) -> tuple[Any, ...]:
        if isinstance(function, Linear):
            return (differentiable(function.transposed)(slope),)
        found = lambda *given: function.slopes(given[:-1], given[-1])  # noqa: E731 - the inputs, then the slope
        return tuple(_called(found, function, function.spaces, (*inputs, slope)))

    applied = jax.custom_vjp(value)
    applied.defvjp(lambda *inputs: (applied(*inputs), inputs), slopes)
    return applied


def _check(function: Differentiable, inputs: tuple[Any, ...]) -> None:
    if len(inputs) != len(function.spaces):
        raise BadInput(f"got {len(inputs)} arrays; expected {len(function.spaces)}")
    for space, array in zip(function.spaces, inputs, strict=True):
        require(space, array, "the array")
        if not np.issubdtype(array.dtype, np.floating):
            raise BadInput(f"the array holds {array.dtype}; expected floating-point numbers")


def _called(
    compute: Callable[..., Any], function: Differentiable, spaces: tuple[Space, ...], inputs: tuple[Any, ...]
) -> Any:
    """JAX arrays of a function's results, one for each space."""
    kind = inputs[0].dtype

    def on_host(*arrays: Any) -> tuple[np.ndarray, ...]:
        found = compute(*(sent(function.device, np.asarray(array)) for array in arrays))
        fields = (found,) if isinstance(found, DeviceArray) else found
        return tuple(array.numpy().astype(kind) for array in fields)

    shapes = tuple(jax.ShapeDtypeStruct(space.shape, kind) for space in spaces)
    return jax.pure_callback(on_host, shapes, *inputs, vmap_method="sequential")
