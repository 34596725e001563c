"""An endless web solved in segments: its frames, its print, and a test for seams."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.methods.papers import BAND, ROLL_TO_ROLL
from vamgpu.operators.web import WebProjection
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.reports import style
from vamgpu.targets.lattices import SheetGyroid
from vamgpu.web import WebGrid
from vamgpu.webs.stream import Stream

if TYPE_CHECKING:
    from vamgpu.targets.implicit import Array

RADIUS, THICKNESS = 7.5, 3.0


def webs(
    device: Device,
    quick: bool = False,
    length: float = 250.0,
    pitch: float = 0.2,
    cell: float = 6.0,
    drift: float = 2.0,
) -> Picture:
    """A film ``length`` [mm] long of cells [mm] that drift along it, in voxels of ``pitch`` [mm]."""
    pitch = 0.4 if quick else pitch
    layers = round(THICKNESS / pitch)
    roller = Roller(RADIUS, Film(THICKNESS, 1.49, 1.33, 0.22), pitch / (RADIUS + 0.5 * THICKNESS))
    cells = SheetGyroid(cell)

    def drifting(l: Array, rho: Array, z: Array) -> Array:  # noqa: E741 - the web's axis
        return cells(l + drift * np.sin(l / 17.0), rho, z + 0.4)

    job = Stream(
        drifting, roller, roller.beam(pitch, 2), length=length, core=1.0,
        pitch=(roller.advance, THICKNESS / layers, pitch), section=(layers, 2), iterations=4 if quick else 100,
        device=device,
    )  # fmt: skip
    whole, scale = _light(replace(job, core=12.0))
    dose, target = _dose(job, whole), _target(job)
    faults = {}
    for overlap in (0.5, 1.0, job.overlap):
        pieces, _ = _light(replace(job, overlap=overlap))
        faults[overlap] = np.abs(_dose(job, pieces) - dose).max(axis=(1, 2))
    along = (np.arange(len(dose)) + 0.5) * job.grid.edges[0]
    figure, axes = style.sheet("a;b;c", 7.0, height_ratios=[1, 1, 1.6])
    window = job.layout.window * job.grid.edges[0]
    extent = (0.0, length, 0.0, THICKNESS)
    for name, values, title, most, colors in (
        ("a", target, "Target, the first two windows of light", 1.0, style.SOLID),
        ("b", dose, "Dose", 1.2, style.DOSE),
    ):
        axes[name].imshow(values[:, :, 0].T, origin="lower", extent=extent, aspect="auto", vmin=0.0, vmax=most,
                          cmap=colors, interpolation="nearest")  # fmt: skip
        axes[name].grid(False)
        axes[name].set(title=title, ylabel="ρ [mm]", xlim=(0, 2.0 * window))
    for overlap, fault in faults.items():
        axes["c"].semilogy(along, np.maximum(fault, 1e-8), label=f"{overlap:g} windows on either side", lw=1.2)
    axes["c"].axhline(1e-3, color=style.QUIET, lw=0.8, ls="--")
    axes["c"].set(title="Segments compared with one piece", xlabel="l along the film [mm]",
                  ylabel="greatest difference of the dose", xlim=(0, length), ylim=(1e-8, 1))  # fmt: skip
    axes["c"].legend(loc="upper right", ncols=3)
    facts = (
        Fact("window of light", window, "mm", 4),
        Fact("segments", float(job.total or 0), "", 3),
        Fact(f"largest difference between segments and one piece, {job.overlap:g} windows on either side",
             float(faults[job.overlap].max()), "", 2, 1e-3, bound="≤"),
        Fact("the same with one window", float(faults[1.0].max()), "", 2),
        Fact("the same with half a window", float(faults[0.5].max()), "", 2),
        Fact("light of a full-on pixel, the same for all frames", scale, "", 3),
    )  # fmt: skip
    caption = (
        "A web whose cells never repeat, solved in one piece and in segments. A segment is one window of light "
        f"long here, and {job.overlap:g} windows more on either side, the default, are solved with it. Step lengths "
        "follow from the light of one angle, and angles outside a segment are assumed to contribute their share of "
        "the dose. A segment therefore gets nearly the same frames as the whole web would, and memory is that of one "
        "segment at any length. Less overlap makes a larger difference."
    )
    return Picture(figure, caption, facts, papers=(ROLL_TO_ROLL, BAND))


def _light(job: Stream) -> tuple[np.ndarray, float]:
    """Light of all angles [angle, r, z], before it becomes bytes, and that of a full-on pixel."""
    found, scale = [], 0.0
    for segment in job:
        found.append(job.solver.buffer().numpy()[job.layout.overlap :][: len(segment.images)])
        scale = segment.scale
    return np.concatenate(found), scale


def _columns(job: Stream, light: np.ndarray) -> int:
    return int((len(light) - job.layout.lead) * job.layout.step)


def _dose(job: Stream, light: np.ndarray) -> np.ndarray:
    grid = WebGrid((_columns(job, light), *job.grid.shape[1:]), job.grid.pitch)
    start = -float(job.layout.lead * job.layout.step)
    A = WebProjection(grid, job.beam, job.wrap, job.device, poses=len(light), start=start)
    return np.asarray(A.T(light))


def _target(job: Stream) -> np.ndarray:
    from vamgpu.webs.tiles import Columns

    columns = Columns(job.tiles, job.grid, job.length)
    assert columns.end is not None
    return columns.take(0, columns.end)
