"""What two operators claim of the light that they solve for, and what is proved of it."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.methods import optimize
from vamgpu.metrics.tolerance import ToleranceWindow, depth_of_fractions, tolerance_window
from vamgpu.operators.projection import Projection
from vamgpu.printing.pack import pack
from vamgpu.printing.proof import Proof
from vamgpu.printing.simulate import simulate
from vamgpu.reports import style
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOOTPRINTS = {"joseph": "interpolated rays (Joseph)", "exact": "exact footprints, point spread"}
"""How an operator weighs light, and what to call it."""
HEIGHT = 0.45
"""Of the slices and rows that are shown, as a share."""


def claimed(
    device: Device, quick: bool = False, pitch: float = 0.15, angles: int = 360, iterations: int = 40
) -> Picture:
    """The boat in straight light, solved by both operators with the default method, proved by traced rays."""
    target = scene.boat(device, 0.6 if quick else pitch)
    given = scene.straight(target, 24 if quick else int(angles), device)
    proofs = {name: _proved(given, target, name, 4 if quick else int(iterations)) for name in FOOTPRINTS}
    curves = {name: _over_tolerance(proof) for name, proof in proofs.items()}
    figure, axes = style.sheet([["a", "b", "e"], ["c", "d", "f"]], 6.6, width_ratios=[1, 1, 1.15])
    for letter, dose, name in (("a", "c", "joseph"), ("b", "d", "exact")):
        _frame(axes[letter], proofs[name], f"One frame, {name}")
        _slice(axes[dose], proofs[name], f"Proved dose, {name}")
    style.scale_bar(axes["c"], 2.0 / target.grid.pitch, "2 mm", below=True)
    _bars(axes["e"], proofs)
    _curves(axes["f"], curves)
    rows = tuple((FOOTPRINTS[name], _numbers(proof, curves[name])) for name, proof in proofs.items())
    header = ("operator that solves", "window claimed", "window proved", "proved − claimed", "W at half a voxel",
              "wrong voxels", "power above half the columns' Nyquist frequency [%]")  # fmt: skip
    table = Table(header, ("+.4f", "+.4f", "+.4f", "+.4f", ".0f", ".1f"), rows)
    facts = tuple(
        Fact(f"proved over claimed, {FOOTPRINTS[name]}", proof.ratio, "", 3)
        for name, proof in proofs.items()
        if isfinite(proof.ratio)  # where a window is claimed at all
    )
    caption = (
        "The boat, 11.5 mm high, in a vat of the resin's index, solved twice with the same method and as many steps. "
        "The operator of interpolated rays knows one point in the middle of a voxel: light can be striped so that "
        "these points are right and everything between them is not. The operator of exact footprints takes the mean "
        "over the voxel's box of a pixel's box behind the lens. Claimed is what each says of its own frames; "
        "proved is what rays traced without either's tables say, on voxels half as wide, shifted by a quarter."
    )
    return Picture(figure, caption, facts, table)


def _proved(given: Projection, target: Target, footprint: str, iterations: int) -> Proof:
    A = Projection(given.grid, given.beam, given.motion, device=given.device, footprint=footprint)
    return simulate(A, pack(optimize(A, target, iterations=iterations)), target)


def _over_tolerance(proof: Proof) -> ToleranceWindow:
    grid = proof.operator.grid
    slabs = proof.fine(grid.inscribed_radius)
    return tolerance_window(
        slabs, depth_of_fractions(proof.target.numpy(), grid), grid.pitch, radius=grid.inscribed_radius
    )


def _numbers(proof: Proof, curve: ToleranceWindow) -> tuple[float, ...]:
    scores = proof.scores
    wrong = float(scores.missing + scores.excess)
    return (
        proof.claimed.window,
        scores.window,
        scores.window - proof.claimed.window,
        curve.half_voxel,
        wrong,
        100 * _fine_power(proof),
    )


def _fine_power(proof: Proof) -> float:
    """Share of the frames' power, the mean left out, above half the columns' Nyquist frequency."""
    power = (np.abs(np.fft.rfft(proof.frames.levels().astype(float), axis=2)) ** 2).sum(axis=(0, 1))
    return float(power[len(power) // 2 :].sum() / power[1:].sum())


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


def _curves(axis: Axes, curves: dict[str, ToleranceWindow]) -> None:
    for (name, curve), color in zip(curves.items(), (style.ORANGE, style.BLUE), strict=True):
        axis.plot(1e3 * curve.distance, curve.window, color=color, label=name)
    half = 0.5e3 * curve.voxel
    axis.axhline(0, color=style.INK, lw=0.8)
    axis.axvline(half, color=style.INK, lw=0.9, ls=(0, (4, 3)))
    axis.set(title="Proved window over tolerance", xlabel="tolerance δ [µm], half a voxel dashed",
             xlim=(0, 4 * half))  # fmt: skip
    axis.legend()
