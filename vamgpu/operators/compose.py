"""Operators made of others, applied in sequence or summed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, DeviceError, ShapeMismatch
from vamgpu.geometry import Beam
from vamgpu.kernels.update import linear
from vamgpu.operators.linear import LinearOperator

GEOMETRY = ("grid", "beam", "motion", "vessel")  # further attributes of a projector that optimizers and reports use

NO_FLOOR = -3e38


class Derived(LinearOperator):
    """An operator made of others, with their geometry if they have one."""

    grid: Any
    beam: Beam
    motion: Any
    vessel: Any


def combine(
    a: float, x: DeviceArray, b: float, y: DeviceArray, out: DeviceArray, floor: float = NO_FLOOR
) -> DeviceArray:
    """out = max(floor, a·x + b·y), returned; out may be x or y."""
    out.device.launch(linear, a=a, x=x, b=b, y=y, floor=floor, out=out)
    return out


def capped(values: DeviceArray, most: float) -> DeviceArray:
    """values = min(values, most), returned: −max(−most, −values)."""
    combine(-1.0, values, 0.0, values, values, floor=-most)
    return combine(-1.0, values, 0.0, values, values)


def inherit(operator: LinearOperator, source: LinearOperator) -> None:
    """Give ``operator`` the geometry of ``source``, if it has one."""
    for name in GEOMETRY:
        if hasattr(source, name):
            setattr(operator, name, getattr(source, name))


def same_device(first: LinearOperator, second: LinearOperator) -> None:
    """Raise `DeviceError` unless both operators are on one device."""
    if first.device is not second.device:
        raise DeviceError(f"{first!r} is on {first.device}, {second!r} on {second.device}; build both on one device")


@final
class Composed(Derived):
    """outer ∘ inner, with the geometry of whichever has one. Raises `ShapeMismatch`, `DeviceError`.

    inner: the operator applied first.  outer: the operator applied to its result.
    """

    def __init__(self, outer: LinearOperator, inner: LinearOperator) -> None:
        if outer.domain != inner.range:
            raise ShapeMismatch(
                f"{outer!r} takes {outer.domain!r}, but {inner!r} gives {inner.range!r}; make them equal"
            )
        same_device(outer, inner)
        self.outer: LinearOperator = outer
        self.inner: LinearOperator = inner
        self._set_spaces(inner.domain, outer.range, inner.device)
        inherit(self, outer)
        inherit(self, inner)

    def __repr__(self) -> str:
        return f"Composed({self.outer!r}, {self.inner!r})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        between = self.device.empty(self.inner.range.shape)
        self.inner.forward(x, between)
        self.outer.forward(between, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        between = self.device.empty(self.inner.range.shape)
        self.outer.transposed(y, between)
        self.inner.transposed(between, out)


@final
class Sum(Derived):
    """Σ weight·operator with the geometry of the first. Raises `BadInput`, `ShapeMismatch`, `DeviceError`.

    terms: operators between the same spaces.  weights: one per term, 1 if none are given.
    """

    def __init__(self, terms: Sequence[LinearOperator], weights: Sequence[float] | None = None) -> None:
        if not terms or (weights is not None and len(weights) != len(terms)):
            raise BadInput(f"a sum got {len(terms)} operators and {len(weights or ())} weights; expected at least one "
                           "operator, and a weight for each")  # fmt: skip
        for term in terms[1:]:
            same_device(terms[0], term)
            if (term.domain, term.range) != (terms[0].domain, terms[0].range):
                raise ShapeMismatch(f"{term!r} maps {term.domain!r} to {term.range!r}, but {terms[0]!r} maps "
                                    f"{terms[0].domain!r} to {terms[0].range!r}; make them equal")  # fmt: skip
        self.terms: tuple[LinearOperator, ...] = tuple(terms)
        self.weights: tuple[float, ...] = (1.0,) * len(terms) if weights is None else tuple(float(w) for w in weights)
        self._set_spaces(terms[0].domain, terms[0].range, terms[0].device)
        inherit(self, terms[0])

    def __repr__(self) -> str:
        return f"Sum({len(self.terms)} of {self.terms[0]!r}, …)"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self._add([term.forward for term in self.terms], x, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._add([term.transposed for term in self.terms], y, out)

    def _add(self, actions: list, x: DeviceArray, out: DeviceArray) -> None:
        actions[0](x, out)
        if self.weights[0] != 1.0:
            combine(self.weights[0], out, 0.0, out, out)
        part = self.device.empty(out.shape) if len(actions) > 1 else out
        for weight, action in zip(self.weights[1:], actions[1:], strict=True):
            action(x, part)
            combine(1.0, out, weight, part, out)
