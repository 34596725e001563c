"""The process window of every method after equal projector evaluations."""

from __future__ import annotations

import warnings

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

SOON = 40


def optimizers(
    device: Device, quick: bool = False, pitch: float = 0.15, angles: int = 240, evaluations: int = 120
) -> Picture:
    """The boat, straight light, no absorption; every method with equal thresholds and cost."""
    target = scene.boat(device, 0.6 if quick else pitch)
    A = scene.straight(target, 24 if quick else int(angles), device)
    most = 8 if quick else int(evaluations)
    budgets = (min(SOON, most // 2), most)
    rows = []
    for name, label in list(LABELS.items())[: 2 if quick else None]:
        plans = [_told(A, target, name, budget) for budget in budgets]
        proofs = [simulate(A, pack(plan), target) for plan in plans]
        judged = [proof.judgement for proof in proofs]
        windows = [each.over_tolerance.at(each.pixel) for each in judged]
        found = (*windows, 1e3 * judged[-1].surface.p95, proofs[-1].scores.window, plans[-1].evaluations)
        rows.append((label, found))
    figure, axes = style.sheet("a", 5.0)
    axis, place = axes["a"], np.arange(len(rows))
    for number, (budget, color) in enumerate(zip(budgets, style.HUES, strict=False)):
        values = [found[number] for _, found in rows]
        axis.barh(place + 0.4 * (0.5 - number), values, 0.36, color=color, label=f"{budget} evaluations")
    axis.axvline(0, color=style.INK, lw=0.8)
    axis.set_yticks(place, [label for label, _ in rows])
    axis.invert_yaxis()
    axis.legend(loc="lower left")
    axis.set(xlabel="window one pixel from the surface, proved from the frames while the vial turns",
             title=f"Boat, {' × '.join(map(str, target.grid.shape))} voxels, {A.motion.angles} angles")  # fmt: skip
    header = ("method", *(f"window 1 pixel from the surface, {n} evaluations" for n in budgets),
              "95 % of the surface within [µm]", "strict window of voxel means", "evaluations spent")  # fmt: skip
    table = Table(header, ("+.4f", "+.4f", ".0f", "+.4f", ".0f"), tuple(rows))
    facts = tuple(
        Fact(f"window of the default method, {n} evaluations", value, "", 3)
        for n, value in zip(budgets, rows[0][1], strict=False)
    )
    caption = (
        "The window one pixel from the surface is the least dose at least a pixel deep in the part minus the greatest "
        "dose at least a pixel outside it, divided by the greatest dose, on voxels finer than a pixel, while the vial "
        "turns. The dose cannot jump at the surface, so the strict window of voxel means, which counts the voxels that "
        f"the surface cuts, says little about a print. All methods but the default require at most {OUTSIDE:g} of the "
        f"part's dose outside and at least {INSIDE:g} inside. Methods with one threshold take the middle; the recipe "
        "and filtered back projection take none. Each may use the same number of projector evaluations, warm starts "
        "included, and returns its best patterns. 8-bit frames are packed with the defaults."
    )
    cited = tuple(dict.fromkeys(paper for name in LABELS for paper in METHODS[name].papers))
    return Picture(figure, caption, facts, table, cited)


def _told(A: Projection, target: Target, name: str, evaluations: int) -> Plan:
    """Best patterns of a method; the picture shows which methods diverge, without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DivergenceWarning)
        return compared(A, target, name, evaluations)
