"""The process window of every method over the projector evaluations it spends."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.errors import DivergenceWarning
from vamgpu.methods import METHODS, Plan
from vamgpu.methods.compare import INSIDE, LABELS, OUTSIDE, compared
from vamgpu.operators.projection import Projection
from vamgpu.printing.pack import pack
from vamgpu.printing.simulate import simulate
from vamgpu.reports import style
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SOON = 40


def optimizers(
    device: Device, quick: bool = False, pitch: float = 0.15, angles: int = 240, evaluations: int = 120
) -> Picture:
    """The boat, straight light, no absorption; every method at equal thresholds and cost."""
    target = scene.boat(device, 0.6 if quick else pitch)
    A = scene.straight(target, 24 if quick else int(angles), device)
    most = 8 if quick else int(evaluations)
    soon = min(SOON, most // 2)
    figure, axes = style.sheet("a", 5.6)
    axis, rows, ends = axes["a"], [], []
    for (name, label), color in zip(LABELS.items(), style.HUES[: len(LABELS)], strict=True):
        plans = [_told(A, target, name, budget) for budget in (soon, most)]
        plan, proved = plans[-1], [simulate(A, pack(plan), target).scores for plan in plans]
        spent, best = _best(plan)
        thick, front = (2.4, 3) if name == next(iter(LABELS)) else (1.5, 2)
        axis.step(*_until(spent, best, most), where="post", color=color, lw=thick, zorder=front)
        if len(spent) == 1:
            axis.plot(spent, best, "o", color=color, ms=5)
        ends.append((best[-1], min(spent[-1], most), label, color))
        late = proved[-1]
        found = (proved[0].window, late.window, plan.window, plan.evaluations, late.iou, 1e6 * late.error_rate)
        rows.append((label, found))
    _labels(axis, ends, most)
    axis.axhline(0, xmax=1 / 1.3, color=style.INK, lw=0.8)
    axis.set(xlabel="projector evaluations", ylabel="strict process window, best so far", xlim=(0, most * 1.3),
             title=f"Boat, {' × '.join(map(str, target.grid.shape))} voxels, {A.motion.angles} angles",
             ylim=(max(min(e[0] for e in ends) - 0.1, -0.6), None))  # fmt: skip
    axis.set_xticks(np.linspace(0, most, 7))
    proved_at = (f"proved window, {n} evaluations" for n in (soon, most))
    header = ("method", *proved_at, "claimed window", "evaluations spent",
              "IoU", "VER [10⁻⁶]")  # fmt: skip
    table = Table(header, ("+.4f", "+.4f", "+.4f", ".0f", ".5f", ".1f"), tuple(rows))
    default = rows[0][1]
    facts = (Fact(f"proved window of the default method, {soon} evaluations", default[0], "", 3),
             Fact(f"proved window of the default method, {most} evaluations", default[1], "", 3))  # fmt: skip
    caption = (
        "The strict process window is the least dose in the part minus the greatest dose outside it, over the greatest "
        "dose, every voxel of the cylinder counted as one or the other, no shell left out. Above zero there is one "
        f"exposure that prints every voxel right. All methods ask for at most {OUTSIDE:g} of the part's dose outside "
        f"and at least {INSIDE:g} inside; those with one threshold take the middle, the recipe and filtered back "
        "projection take none. All may spend the same projector evaluations, one forward and one back projection each, "
        "warm starts included, and return the best light they found. The curves are what they claim on the way; proved "
        "is what the simulation makes of the frames of 8 bits, packed by default, as are IoU and VER."
    )
    cited = tuple(dict.fromkeys(paper for name in LABELS for paper in METHODS[name].papers))
    return Picture(figure, caption, facts, table, cited)


def _told(A: Projection, target: Target, name: str, evaluations: int) -> Plan:
    """Best light of a method; that some diverge shows in the picture and needs no warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DivergenceWarning)
        return compared(A, target, name, evaluations)


def _best(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Pairs spent and the best window of the light held up to there."""
    spent = np.array([step.evaluations for step in plan.history])
    return spent, np.maximum.accumulate([step.window for step in plan.history])


def _until(spent: np.ndarray, best: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """The curve drawn on to the last pair, for methods that go on."""
    end = most if len(spent) > 1 else spent[-1]
    return np.append(np.minimum(spent, most), end), np.append(best, best[-1])


def _labels(axis: Axes, ends: list[tuple[float, float, str, str]], most: int) -> None:
    """Names at the ends of the curves, moved apart where they would overlap."""
    least = (max(e[0] for e in ends) - min(e[0] for e in ends)) / 16 or 0.01
    height = -np.inf
    for value, _, label, color in sorted(ends):
        height = max(value, height + least)
        text = f"{label}  {value:+.3f}".replace("-0", "−0")
        axis.text(most * 1.015, height, text, color=color, va="center", fontsize=9)
