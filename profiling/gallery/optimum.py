"""The widest window of any patterns: the optimum, methods that approach it, and its bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

from profiling import slices
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import bound
from vamgpu.methods.compare import compared
from vamgpu.operators.projection import Projection
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABELS = {"ramp": '"ramp", the default', "lbfgs": '"lbfgs"', "osmo": '"osmo"'}
BOUNDED = (70, 120, 250, 500, 1000)
"""Evaluations after which the bound is computed from the dual variables."""
STOPS = (4, 6, 9, 13, 20, 40, 100, 200)
"""Evaluations after which the patterns of a method are judged, besides the last."""


def optimum(device: Device, quick: bool = False, part: str = "cross", evaluations: int = 400) -> Picture:
    """A slice of 40 × 40 voxels in straight light; one of those in `profiling.slices`."""
    parts = slices.slices() | slices.more()
    if part not in parts:
        raise BadInput(f"part is {part!r}; expected one of {', '.join(parts)}")
    grid, beam = Grid((slices.SIDE, slices.SIDE, 1), slices.PITCH), Beam((slices.WIDE, 1), slices.PITCH)
    A, fractions = Projection(grid, beam, Turntable(slices.ANGLES), None, device), parts[part]
    most, bounded = (20, BOUNDED[:1]) if quick else (int(evaluations), BOUNDED)
    matrix = slices.entries()
    top = slices.optimum(matrix / matrix.max(), fractions[:, :, 0] >= 0.5, grid.cylinder())
    budgets = (*(stop for stop in STOPS if stop < most), most)
    curves = {name: [compared(A, fractions, name, budget) for budget in budgets] for name in LABELS}
    plans = {name: curve[-1] for name, curve in curves.items()}
    limits = {n: bound(A, fractions, evaluations=n).value for n in bounded}
    figure, axes = style.sheet("abb", 4.4)
    dose = plans["ramp"].dose().numpy()[:, :, 0]
    style.shown(axes["a"], dose, f'Dose of "ramp", {part}', cmap="inferno", vmin=0.0)
    axis: Axes = axes["b"]
    axis.axhline(top, color=style.INK, lw=1.2, ls=(0, (4, 3)), label="optimum, by linear programming")
    axis.plot(list(limits), list(limits.values()), "v", color=style.RED, ms=6, label="upper limit by dual variables")
    for (name, label), color in zip(LABELS.items(), style.HUES, strict=False):
        judged = [plan for plan in curves[name] if plan.window > 0.0]
        axis.plot([p.evaluations for p in judged], [p.window for p in judged], ".-", color=color, label=label)
    axis.set(xscale="log", xlabel="projector evaluations", ylabel="strict process window", ylim=(0.0, 1.25 * top))
    axis.legend(loc="lower right", fontsize=8)
    facts = (
        Fact("widest window of any patterns, by linear programming", top, "", 4),
        Fact(f'window of "ramp" after {most} evaluations, divided by it', plans["ramp"].window / top, "", 4),
        *(Fact(f"bound after {n} evaluations, divided by it", value / top, "", 4, 1.0, "weak duality", "≥")
          for n, value in limits.items()),
    )  # fmt: skip
    table = Table(("method", "window", "share of the optimum"), ("+.4f", ".3f"),
                  tuple((LABELS[name], (plan.window, plan.window / top)) for name, plan in plans.items()))  # fmt: skip
    caption = (
        "A method reports what it found, not the best possible. For one slice, linear programming on the projector's "
        "float64 matrix gives the widest strict window of any patterns. Dual variables of the dose limits bound it for "
        "parts of any size: by weak duality, no patterns have a wider window. Points are the strict windows of the "
        "patterns that a method returns after so many evaluations, on the same voxels as the optimum and the table. "
        "A strict window counts the voxels at the surface, across which the default lets the dose ramp. Methods use "
        "equal thresholds."
    )
    papers = tuple(dict.fromkeys(paper for plan in plans.values() for paper in plan.papers))
    return Picture(figure, caption, facts, table, papers)
