"""Partly filled voxels: the exposure disk, its spokes, and volumes against the pitch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE
from vamgpu.reports import style
from vamgpu.targets.shapes import build
from vamgpu.targets.shapes.calibration import GAPS_PX, SPOKES_PX
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RIM, STANDOFF, SPACING = 6.0, 0.067 * max(GAPS_PX), 1.0
"""Radius of the disk, reach of its spokes, and distance between the two of a pair [mm]."""


def voxels(device: Device, quick: bool = False, pitch: float = 0.067) -> Picture:
    """The exposure disk at the pitch of a pixel, and the boat over a range of pitches."""
    step = 0.134 if quick else pitch
    disk = build("exposure_disk")
    target = Target.from_mesh(disk, factor=1.0, pitch=step, device=device)
    plane = target.numpy()[:, :, target.grid.shape[2] // 2].astype(np.float64)
    shift = disk.placed(factor=1.0).vertices.mean(axis=0) - disk.vertices.mean(axis=0)
    figure, axes = style.sheet("abb;acd", 5.5, width_ratios=[1.75, 1, 1])
    drawn = style.shown(axes["a"], plane, f"Exposure disk, voxels of {1e3 * step:.0f} µm", step, cmap=style.SOLID)
    axes["a"].set(xlabel="x [mm]", ylabel="y [mm]")
    style.bar(drawn, axes["a"], "filled fraction", location="bottom", fraction=0.03)
    _zoom(axes["c"], plane, step, shift, 0, "Spokes of 1 pixel")
    _zoom(axes["d"], plane, step, shift, len(SPOKES_PX) - 1, "Spokes of 7 pixels")
    widths = [1e3 * _width(plane, step, shift, k) for k in range(len(SPOKES_PX))]
    rows = _volumes(axes["b"], device, (16, 24) if quick else (32, 48, 64, 96, 128, 192))
    facts = (
        Fact("mean width of the spokes of 1 pixel", widths[0], "µm", 3, 67.0, "1 × 67 µm"),
        Fact("mean width of the spokes of 7 pixels", widths[-1], "µm", 4, 469.0,
             "7 × 67 µm; the paper prints 459 µm"),
        Fact("largest deviation of a spoke from its width",
             max(abs(w - 67.0 * px) for w, px in zip(widths, SPOKES_PX, strict=True)), "µm", 2),
        Fact("figure of merit: half disks that hold, voxels filled by half or more", float(_held(plane, step, shift)),
             "", 2, 7.0, "ideal of the paper, eq. 2"),
        Fact("largest change of a voxel after moving the mesh by 10 mm", _moved(device, 0.25), "", 2),
    )  # fmt: skip
    caption = (
        "Each voxel holds the fraction that the part fills; details smaller than a voxel therefore keep their size. "
        "Spokes of one pixel survive at any angle, and widths summed across them are correct although edges cut "
        "through voxels. Volumes of the boat are accurate on coarse grids; voxels that are either full or empty give "
        "larger, random errors."
    )
    table = Table(("voxels along the height of the boat", "fractions [%]", "full or empty [%]"), ("+.5f", "+.3f"), rows)
    return Picture(figure, caption, facts, table, (AUTOMATIC_EXPOSURE,))


def _frame(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Outward and sideways direction of half disk k."""
    angle = 2.0 * np.pi * k / (len(SPOKES_PX) + len(GAPS_PX))
    return np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])


def _zoom(axis: Axes, plane: np.ndarray, step: float, shift: np.ndarray, k: int, title: str) -> None:
    style.shown(axis, plane, title, step, cmap=style.SOLID)
    x, y = _frame(k)[0] * (RIM + 0.5 * STANDOFF + 0.2) + shift[:2]
    axis.set(xlim=(x - 1.0, x + 1.0), ylim=(y - 1.0, y + 1.0), xlabel="x [mm]")
    axis.locator_params(nbins=4)


def _width(plane: np.ndarray, step: float, shift: np.ndarray, k: int) -> float:
    """Mean width [mm] of the two spokes of half disk k: fractions integrated across both, averaged along them."""
    from scipy.ndimage import map_coordinates

    out, side = _frame(k)
    along = np.linspace(RIM + 0.4 * STANDOFF, RIM + 0.6 * STANDOFF, 41)
    across = np.linspace(-1.0, 1.0, 2001) * (0.5 * SPACING + 0.35)
    points = along[:, None, None] * out + across[None, :, None] * side + shift[:2]
    index = points / step + 0.5 * (np.array(plane.shape) - 1.0)
    filled = map_coordinates(plane, index.transpose(2, 0, 1), order=1)
    return 0.5 * float(filled.mean(axis=0).sum() * (across[1] - across[0]))


def _held(plane: np.ndarray, step: float, shift: np.ndarray) -> int:
    """Number of half disks connected to the disk, through voxel faces."""
    from scipy.ndimage import label

    pieces: np.ndarray = label(plane >= 0.5)[0]  # type: ignore[index]
    out = [np.zeros(2), *(_frame(k)[0] * (RIM + STANDOFF + 0.4) for k in range(len(SPOKES_PX) + len(GAPS_PX)))]
    index = np.round((np.array(out) + shift[:2]) / step + 0.5 * (np.array(plane.shape) - 1.0)).astype(int)
    found = pieces[index[:, 0], index[:, 1]]
    return int((found[1:] == found[0]).sum())


def _volumes(axis: Axes, device: Device, counts: tuple[int, ...]) -> tuple[tuple[str, tuple[float, ...]], ...]:
    """Deviation [%] of the boat's volume over the voxels along its height."""
    boat = build("boat")
    rows = []
    for n in counts:
        target = Target.from_mesh(boat, height=boat.height, pitch=boat.height / n, device=device)
        full = float((target.numpy() >= 0.5).sum()) * target.grid.voxel_volume
        rows.append((str(n), tuple(100.0 * (v / boat.volume - 1.0) for v in (target.volume, full))))
    values = np.abs([row for _, row in rows])
    for column, color, label in ((0, style.BLUE, "fractions"), (1, style.ORANGE, "full or empty")):
        axis.loglog(counts, values[:, column], "o-", color=color)
        place = (0, -18 + 27 * column)
        axis.annotate(label, (counts[0], values[0, column]), place, textcoords="offset points", color=color)
    axis.axhline(0.1, color=style.RED, lw=1, ls=(0, (4, 3)))
    axis.set(title="Volume of the boat against its mesh", xlabel="voxels along its height", ylabel="deviation [%]")
    axis.set_xticks(counts, [str(n) for n in counts])
    axis.minorticks_off()
    return tuple(rows)


def _moved(device: Device, pitch: float) -> float:
    """Largest change of a fraction when the boat is moved by 10 mm along each axis before it is centered."""
    boat = build("boat")
    here, there = (Target.from_mesh(s, height=11.5, pitch=pitch, device=device).numpy()
                   for s in (boat, boat.translated((10.0, 10.0, 10.0))))  # fmt: skip
    return float(np.abs(here - there).max())
