"""`superpose`: light of two colors by any rule."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Protocol

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, EmptyMesh
from vamgpu.methods.dual.colors import Colors, DualPlan, Pass
from vamgpu.methods.dual.least import LeastSquares
from vamgpu.methods.dual.passes import Bench, DualColor, SingleColor, Tolerant
from vamgpu.methods.part import on_device
from vamgpu.operators.reductions import extent

METHODS: dict[str, Callable[[], Any]] = {
    "sc": SingleColor,
    "sc2": Tolerant,
    "dc": DualColor,
    "dc kept": lambda: DualColor(recompute=False),
    "least squares": LeastSquares,
}
"""Names a rule can be chosen by, with default parameters."""


class Rule(Protocol):
    """A way to find light of two colors."""

    papers: ClassVar[tuple[str, ...]]

    def steps(self, bench: Bench) -> Iterator[Pass]:
        """Improve ``bench.light`` and ``bench.uv``; both are in units of the design whenever it yields."""
        ...


def superpose(
    colors: Colors,
    design: Any,
    method: str | Rule = "least squares",
    *,
    progress: Callable[[Pass], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> DualPlan:
    """Find visible and UV light [angle, r, z] ≥ 0 whose difference of doses is the design, on the colors' device.

    design: a `Target`, or gray values 0..1 [x, y, z] (NumPy or on the device).  method: a name of `METHODS` or an
    instance.  progress: gets every `Pass`.  cancel: asked after each pass; the plan reached so far is returned then.
    Doses add linearly and UV dose undoes visible dose, ``colors.strength`` to one: no chemistry is asked here.
    Raises `BadInput`, `ShapeMismatch`, `EmptyMesh`, `DeviceError`.
    """
    rule = _rule(method)
    started = time.perf_counter()
    bench, history = Bench(colors, _checked(colors, design)), []
    for record in rule.steps(bench):
        history.append(record)
        if progress is not None:
            progress(record)
        if cancel is not None and cancel():
            break
    seconds = time.perf_counter() - started
    return DualPlan(bench.light, bench.uv, colors, rule, tuple(history), seconds, rule.papers)


def _checked(colors: Colors, design: Any) -> DeviceArray:
    projector: Any = colors.visible
    values = on_device(projector, design)
    low, high = extent(values)
    if not (low >= 0.0 and high <= 1.0):
        raise BadInput(f"the design reaches from {low:g} to {high:g}; wanted gray values in 0..1: scale it")
    if high == 0.0:
        raise EmptyMesh("every voxel of the design is 0; wanted some that are filled")
    return values


def _rule(method: str | Rule) -> Rule:
    if isinstance(method, str):
        if method not in METHODS:
            raise BadInput(f"no rule {method!r}; there are {', '.join(METHODS)}, or give an instance")
        return METHODS[method]()
    if isinstance(method, type) or not hasattr(method, "steps"):
        raise BadInput(f"got {method!r} as rule; wanted a name ({', '.join(METHODS)}) or e.g. Tolerant()")
    return method
