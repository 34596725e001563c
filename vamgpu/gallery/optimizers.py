"""The process window of every method over the projector pairs it spends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.gallery import scene, style
from vamgpu.gallery.picture import Fact, Picture, Table
from vamgpu.metrics import score
from vamgpu.operators.projection import Projection
from vamgpu.optimize import METHODS, Plan, optimize
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABELS = {
    "window": "process window (default)", "lbfgs": "L-BFGS", "bclp": "BCLP", "penalty": "penalty", "cal": "CAL",
    "osmo": "OSMO", "recipe": "recipe", "fbp": "filtered back projection",
}  # fmt: skip
SOON = 40


def optimizers(
    device: Device, quick: bool = False, pitch: float = 0.15, angles: int = 240, pairs: int = 120
) -> Picture:
    """The boat, straight light, no absorption; every method spends ``pairs`` projector pairs or stops by itself."""
    target = scene.boat(device, 0.6 if quick else pitch)
    A = scene.straight(target, 24 if quick else int(angles), device)
    most = 8 if quick else int(pairs)
    soon = min(SOON, most)
    figure, axes = style.sheet("a", 5.6)
    axis, rows, ends = axes["a"], [], []
    for (name, label), color in zip(LABELS.items(), style.HUES, strict=True):
        plan = _run(A, target, name, most)
        spent, best = _best(plan)
        thick, front = (2.4, 3) if name == "window" else (1.5, 2)
        axis.step(*_until(spent, best, most), where="post", color=color, lw=thick, zorder=front)
        if len(spent) == 1:
            axis.plot(spent, best, "o", color=color, ms=5)
        ends.append((best[max(int((spent <= most).sum()) - 1, 0)], min(spent[-1], most), label, color))
        scores = score(plan.dose(), target.on(device))
        early, late = (best[max(int((spent <= limit).sum()) - 1, 0)] for limit in (soon, most))
        rows.append((label, (early, late, plan.pairs, scores.iou, 1e6 * scores.error_rate)))
    _labels(axis, ends, most)
    axis.axhline(0, xmax=1 / 1.3, color=style.INK, lw=0.8)
    axis.set(xlabel="projector pairs", ylabel="strict process window, best so far", xlim=(0, most * 1.3),
             title=f"Boat, {' × '.join(map(str, target.grid.shape))} voxels, {A.motion.angles} angles",
             ylim=(max(min(e[0] for e in ends) - 0.1, -0.6), None))  # fmt: skip
    axis.set_xticks(np.linspace(0, most, 7))
    header = ("method", f"window by {soon} pairs", f"window by {most} pairs", "pairs spent", "IoU", "VER [10⁻⁶]")
    table = Table(header, ("+.4f", "+.4f", ".0f", ".5f", ".1f"), tuple(rows))
    default = rows[0][1]
    facts = (Fact(f"window of the default method by {soon} pairs", default[0], "", 3),
             Fact(f"window of the default method by {most} pairs", default[1], "", 3))  # fmt: skip
    caption = (
        "The strict process window is the least dose in the part minus the greatest dose outside it, over the greatest "
        "dose, every voxel of the cylinder counted as one or the other, no shell left out. Above zero there is one "
        "exposure that prints every voxel right. A projector pair is one forward and one back projection; those of a "
        "warm start count. Methods run with their default parameters; IoU and VER are those of the final light."
    )
    cited = tuple(dict.fromkeys(paper for name in LABELS for paper in METHODS[name].papers))
    return Picture(figure, caption, facts, table, cited)


def _run(A: Projection, target: Target, name: str, most: int) -> Plan:
    """As many iterations as fit: methods spend one or two pairs on each, line searches more."""
    if name == "fbp":
        return optimize(A, target, name)
    enough: list[float] = []
    plan = optimize(A, target, name, iterations=1)
    while plan.pairs < most and len(plan.history) not in enough:
        enough.append(len(plan.history))
        each = plan.pairs / len(plan.history)
        plan = optimize(A, target, name, iterations=len(plan.history) + max(1, int((most - plan.pairs) / each)),
                        resume=plan)  # fmt: skip
    return plan


def _best(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Pairs spent and the best window up to there."""
    spent = np.array([step.pairs for step in plan.history])
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
