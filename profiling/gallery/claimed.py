"""Windows that two operators predict for the patterns that they find, compared with the proofs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture, Table
from profiling.gallery.scale_bar import scale_bar
from vamgpu.backend.device import Device
from vamgpu.methods import optimize
from vamgpu.operators.projection import Projection
from vamgpu.printing.pack import pack
from vamgpu.printing.proof import Proof
from vamgpu.printing.simulate import simulate
from vamgpu.reports import style
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOOTPRINTS = {"joseph": "interpolated rays (Joseph)", "exact": "exact footprints, point spread"}
"""How an operator weights light, and its label."""
CHANGES = ("bodies_lost", "bodies_merged", "bodies_broken", "bodies_extra", "holes_closed", "holes_opened",
           "cavities_filled", "cavities_extra")  # fmt: skip
"""Errors that a print may have."""
HEIGHT = 0.45
"""Slices and rows that are shown, as shares."""


def claimed(
    device: Device, quick: bool = False, pitch: float = 0.15, angles: int = 360, iterations: int = 40
) -> Picture:
    """The boat in straight light, solved by both operators with the default method, proved by traced rays."""
    target = scene.boat(device, 0.6 if quick else pitch)
    given = scene.straight(target, 24 if quick else int(angles), device)
    proofs = {name: _proved(given, target, name, 4 if quick else int(iterations)) for name in FOOTPRINTS}
    figure, axes = style.sheet([["a", "b", "e"], ["c", "d", "f"]], 6.6, width_ratios=[1, 1, 1.15])
    for letter, dose, name in (("a", "c", "joseph"), ("b", "d", "exact")):
        _frame(axes[letter], proofs[name], f"One frame, {name}")
        _slice(axes[dose], proofs[name], f"Proved dose, {name}")
    scale_bar(axes["c"], 2.0 / target.grid.pitch, "2 mm", below=True)
    _bars(axes["e"], proofs)
    _curves(axes["f"], proofs)
    rows = tuple((FOOTPRINTS[name], _numbers(proof)) for name, proof in proofs.items())
    header = ("operator that solves", "window claimed", "window proved", "W 1 pixel", "bodies, holes, cavities wrong",
              "95 % [µm]")  # fmt: skip
    table = Table(header, ("+.4f", "+.4f", "+.4f", ".0f", ".0f"), rows)
    pixel = next(iter(proofs.values())).judgement.pixel
    facts = (Fact("width of a pixel in the resin", 1e3 * pixel, "µm", 3),)
    said = (f"by {FOOTPRINTS[name]}: “{proof.verdict.sentence}”" for name, proof in proofs.items())
    caption = (
        "The boat, 11.5 mm high, in an index-matched vat, solved twice with the same method and the same number of "
        "steps. The operator of interpolated rays samples one point in the middle of a voxel. The operator of exact "
        "footprints averages the light of a pixel, blurred by the lens, over the voxel. “Claimed” is the strict window "
        "according to each operator; “proved” is the window from independently traced rays. W one pixel from the "
        f"surface, bodies and surface are those of the print, on voxels half as wide. The verdicts: {'; '.join(said)}"
    )
    return Picture(figure, caption, facts, table)


def _proved(given: Projection, target: Target, footprint: str, iterations: int) -> Proof:
    A = Projection(given.grid, given.beam, given.motion, device=given.device, footprint=footprint)
    return simulate(A, pack(optimize(A, target, iterations=iterations)), target)


def _numbers(proof: Proof) -> tuple[float, ...]:
    judgement = proof.judgement
    changes = judgement.surface.changes
    return (
        proof.claimed.window,
        proof.scores.window,
        judgement.over_tolerance.at(judgement.pixel),
        float(sum(getattr(changes, kind) for kind in CHANGES)),
        1e3 * judgement.surface.p95,
    )


def _frame(axis: Axes, proof: Proof, title: str) -> None:
    levels = proof.frames.levels()
    picture = levels[0][::-1].T / 255.0
    style.shown(axis, picture, title, cmap=style.LIGHT, vmin=0, vmax=1)


def _slice(axis: Axes, proof: Proof, title: str) -> None:
    dose = np.where(proof.operator.grid.cylinder()[:, :, None], proof.dose.numpy() / proof.scores.peak, np.nan)
    style.shown(axis, scene.level(dose, HEIGHT), title, vmin=0, vmax=1)


def _bars(axis: Axes, proofs: dict[str, Proof]) -> None:
    place = np.arange(len(proofs))
    for shift, name, color in ((-0.2, "claimed", style.QUIET), (0.2, "proved", style.BLUE)):
        values = [(p.claimed if name == "claimed" else p.scores).window for p in proofs.values()]
        bars = axis.bar(place + shift, values, 0.36, color=color, label=name)
        axis.bar_label(bars, [f"{v:+.3f}".replace("-", "−") for v in values], padding=2, fontsize=8.5)
    axis.axhline(0, color=style.INK, lw=0.8)
    axis.set(title="Strict process window", xticks=place, xticklabels=list(proofs))
    axis.margins(y=0.15)
    axis.legend(ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.08))


def _curves(axis: Axes, proofs: dict[str, Proof]) -> None:
    pixel = 0.0
    for (name, proof), color in zip(proofs.items(), (style.ORANGE, style.BLUE), strict=True):
        curve, pixel = proof.judgement.over_tolerance, 1e3 * proof.judgement.pixel
        axis.plot(1e3 * curve.distance, curve.window, color=color, label=name)
    axis.axhline(0, color=style.INK, lw=0.8)
    axis.axvline(pixel, color=style.INK, lw=0.9, ls=(0, (4, 3)))
    axis.set(title="Window over distance", xlabel="from the surface [µm], a pixel dashed", xlim=(0, 2 * pixel))
    axis.legend()
