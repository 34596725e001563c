"""Patterns for a machine with small errors, compared with patterns for one without."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from profiling import slices
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ToleranceWarning
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import optimize
from vamgpu.methods.tolerances import Corner, Tolerances, at
from vamgpu.metrics.tolerance import Depth, ToleranceWindow, depth_of_fractions, tolerance_window
from vamgpu.operators.projection import Projection
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.printing.pack import pack
from vamgpu.printing.pictures import EXCESS, HIT, MISSING, OUTSIDE, verdicts
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FINER = 2
"""Voxels along a pixel."""
DISTANCES = {"half a pixel": 0.5, "one pixel": 1.0}
"""Distances from the surface at which windows are given [pixels]."""


def robust(
    device: Device, quick: bool = False, part: str = "bars", angles: int = 48, iterations: int = 30,
    axis: float = 0.25, least: float = 0.5, most: float = 1.0,
) -> Picture:  # fmt: skip
    """A slice in straight light; the axis is off by ``axis`` pixels, and the point spread varies."""
    parts = slices.slices() | slices.more() | slices.small()
    if part not in parts:
        raise BadInput(f"part is {part!r}; expected one of {', '.join(parts)}")
    fraction, step, steps = np.repeat(np.repeat(parts[part], FINER, 0), FINER, 1), slices.PITCH, int(iterations)
    beam, motion = Beam((slices.WIDE, 1), step), Turntable(12 if quick else int(angles))
    A = Projection(Grid(fraction.shape, step / FINER), beam, motion, None, device)
    depth = depth_of_fractions(fraction, A.grid, flat=True, reach=2.0 * step, device=device)
    off = Tolerances(axis=axis * step, spread=(least * step, most * step))
    figure, axes = style.sheet("abc;def", 6.6, width_ratios=[1, 1, 1.25])
    facts: list[Fact] = []
    rows: list[tuple[str, tuple[float, ...]]] = []
    for row, (name, tolerances) in zip(("abc", "def"), (("nominal", None), ("robust", off)), strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ToleranceWarning)
            plan = optimize(A, fraction, iterations=3 if quick else steps, tolerances=tolerances, progress=False)
        light = pack(plan).irradiance(device)
        judged = {corner: _judged(at(A, corner), light, depth) for corner in off.corners()}
        facts += _facts(name, judged, step)
        rows += _rows(name, judged, step)
        threshold = 0.5 * sum(_limits(judged, 0.5 * step))
        darkest = min(judged, key=lambda corner: judged[corner].limits(0.5 * step)[0])
        for panel, corner in zip(row, (Corner(), darkest), strict=False):
            dose = IndependentExposure(at(A, corner)).averaged(light)[0].numpy()
            _printed(axes[panel], (A, fraction, depth), dose > threshold, f"{name} patterns, {corner}")
        _ranges(axes[row[2]], judged, threshold, name, step)
    table = Table(("patterns and corner", "least dose in the part", "greatest outside",
                   *(f"window {where} from the surface" for where in DISTANCES)),
                  (".3f", ".3f", "+.3f", "+.3f"), tuple(rows))  # fmt: skip
    caption = (
        "A slice printed with patterns planned without errors (nominal patterns) and with patterns planned for all "
        f"tolerance corners at once (robust patterns): an axis of rotation {axis:g} pixel off to either side, a point "
        f"spread of {least:g} to {most:g} pixel. Voxels are half a pixel wide. Left: the print without errors. Middle: "
        "the print at the corner with the least dose in the part, with the same threshold. Right: the doses of part "
        "and voids at every corner, half a pixel or more from the surface; patterns print there if all bars of the "
        "part lie above those of the voids. Details one pixel wide have no point that deep and are not judged. Both "
        "took the same number of iterations and are judged from their 8-bit frames, along rays traced for every corner "
        "while the vial turns. Where bars and gaps are two or three pixels wide, tolerances change the windows of the "
        "default method only a little: its dose ramps across the surface without them too."
    )
    return Picture(figure, caption, tuple(facts), table)


def _judged(A: Any, light: Any, depth: Depth) -> ToleranceWindow:
    """The window of light against the distance from the surface, on voxels finer than those of a projector."""
    exposure, radius = IndependentExposure(A), A.grid.inscribed_radius
    return tolerance_window(exposure.fine(light, radius), depth, A.grid.pitch, radius=radius, reach=2.0 * A.beam.pitch)


def _limits(judged: dict[Corner, ToleranceWindow], distance: float) -> tuple[float, float]:
    """Least dose in the part and greatest outside at any corner."""
    least, leak = zip(*(found.limits(distance) for found in judged.values()), strict=True)
    return min(least), max(leak)


def _peak(judged: dict[Corner, ToleranceWindow]) -> float:
    return max(found.peak for found in judged.values())


def _window(judged: dict[Corner, ToleranceWindow], distance: float) -> float:
    """Window with one threshold for all corners."""
    least, leak = _limits(judged, distance)
    return (least - leak) / _peak(judged)


def _facts(name: str, judged: dict[Corner, ToleranceWindow], step: float) -> list[Fact]:
    """Windows with one threshold for all corners, and without errors."""
    found = []
    for where, share in DISTANCES.items():
        told = f"{name} patterns, window {where} from the surface"
        found.append(Fact(f"{told}, one threshold for all corners", _window(judged, share * step), "", 3))
        found.append(Fact(f"{told}, without errors", judged[Corner()].at(share * step), "", 3))
    return found


def _rows(name: str, judged: dict[Corner, ToleranceWindow], step: float) -> list[tuple[str, tuple[float, ...]]]:
    """Doses half a pixel from the surface, over the greatest of all corners, and the windows of every corner."""
    top, rows = _peak(judged), []
    for corner, found in judged.items():
        least, leak = found.limits(0.5 * step)
        windows = (found.at(share * step) for share in DISTANCES.values())
        rows.append((f"{name} patterns: {corner}", (least / top, leak / top, *windows)))
    return rows


def _printed(axis: Axes, part: Any, solid: np.ndarray, title: str) -> None:
    from matplotlib.colors import ListedColormap

    A, fraction, depth = part
    colors = ["#f2f4f7", "#9fb4cc", style.RED, style.ORANGE, "white"]
    codes = dict(zip((0, HIT, MISSING, EXCESS, OUTSIDE), range(5), strict=True))
    verdict = verdicts(fraction, solid, A.grid.cylinder())
    far = np.abs(depth(*A.grid.axes()).numpy()) >= 0.5 * A.beam.pitch
    wrong = int((((verdict == MISSING) | (verdict == EXCESS)) & far).sum())
    coded = np.vectorize(codes.get)(verdict[:, :, 0])
    style.shown(axis, coded, f"{title}:\n{wrong:,} voxels wrong off the surface",
                cmap=ListedColormap(colors), vmin=-0.5, vmax=4.5)  # fmt: skip


def _ranges(axis: Axes, judged: dict[Corner, ToleranceWindow], threshold: float, name: str, step: float) -> None:
    top = _peak(judged)
    for place, found in enumerate(judged.values()):
        least, leak = (value / top for value in found.limits(0.5 * step))
        axis.barh(place + 0.19, found.peak / top - least, 0.34, left=least, color=style.BLUE, label="part")
        axis.barh(place - 0.19, leak, 0.34, color=style.ORANGE, label="voids")
    axis.axvline(threshold / top, color=style.INK, lw=1.2, ls=(0, (4, 3)))
    axis.set_yticks(range(len(judged)), [str(corner).replace(", ", "\n") for corner in judged], fontsize=6)
    window = f"{_window(judged, 0.5 * step):+.3f}".replace("-", "−")
    axis.set(title=f"{name} patterns: window {window}", xlim=(0, 1), xlabel="dose over its greatest")
    axis.invert_yaxis()
    handles, labels = axis.get_legend_handles_labels()
    axis.legend(handles[:2], labels[:2], loc="lower left", fontsize=8, frameon=True, framealpha=1.0)
