"""Rays through a vial, their losses, where they are dense, and the dose they leave."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.deposit import deposit
from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable, centers
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE, VIAL
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER_RADIUS, PAPER_LATERAL = 8.27, 0.045


def vial(
    device: Device,
    quick: bool = False,
    radius: float = 12.4,
    wall: float = 1.0,
    resin_index: float = 1.49962,
    wall_index: float = 1.473,
    bath_index: float = 1.0,
    absorption: float = 0.05,
    pixel: float = 0.067,
) -> Picture:
    """The vial of the automatic exposure paper, in air."""
    glass = Vial(radius, wall, resin_index, wall_index, bath_index, absorption)
    lit = lit_at_every_pose(glass, 360 if quick else 3600)
    figure, axes = style.sheet("ab;cd", 8.2)
    draw_rays(axes["a"], glass)
    loss = _transmittance(axes["b"], glass)
    crowd = _density(axes["c"], glass, 60 if quick else 400)
    dose = _flat_beam(axes["d"], glass, device, 40 if quick else 200)
    lateral = float(np.diff(glass.chords(np.array([-0.5, 0.5]) * pixel).p)[0])
    facts = (
        Fact("printable radius, by scanning for points lit at every angle", lit, "mm",
             expected=PAPER_RADIUS, source="paper: 24.8 mm vial, n = 1.49962, no bath"),
        Fact("lateral voxel of a pixel in the resin", 1e3 * lateral, "µm", 3,
             expected=1e3 * PAPER_LATERAL, source="67 µm / 1.49962, rounded"),
        *loss, *crowd, *dose,
    )  # fmt: skip
    caption = (
        "Parallel light meets a vial of resin that turns in air. It bends towards the axis; the outer resin therefore "
        "stays dark at some angles. Only inside the printable radius does exactly one ray light every point at every "
        "angle. The farther a ray passes from the axis, the more the two faces reflect. Rays converge; light therefore "
        "grows denser downstream. A uniform beam leaves more dose at the rim than on the axis. The back projection, "
        "which gathers the ray through each voxel, agrees inside that radius with a scatter of every ray's energy, "
        "which also covers the rim."
    )
    return Picture(figure, caption, facts, papers=(AUTOMATIC_EXPOSURE, VIAL))


def lit_at_every_pose(glass: Vial, poses: int) -> float:
    """Radius [mm] up to which every point of a circle is lit at every angle, to 0.4 µm, from the ray map alone."""
    angle = np.linspace(0.0, 2.0 * np.pi, poses, endpoint=False)
    low, step = 0.0, 0.031 * glass.inner_radius
    while step > 2e-5:
        r = np.arange(low + step, min(low + 32 * step, glass.inner_radius), step)
        _, weight = glass.illuminate(r[:, None] * np.cos(angle), r[:, None] * np.sin(angle))
        dark = np.flatnonzero((weight <= 0).any(axis=1))
        low, step = float((r[dark[0]] if dark.size else r[-1] + step) - step), step / 30.0
    return low


def draw_rays(axis: Axes, glass: Vial, count: int = 23) -> None:
    """Rays from the left through wall and resin; light travels to the right."""
    from matplotlib.patches import Circle

    R = glass.radius
    axis.add_patch(Circle((0, 0), R, fc=style.GLASS, ec="none"))
    axis.add_patch(Circle((0, 0), glass.inner_radius, fc=style.RESIN, ec="none"))
    u = np.linspace(-0.97, 0.97, count) * glass.aperture
    for offset, p, d, length in zip(u, *_chords(glass, u), strict=True):
        axis.plot(*_path(R, offset, p, d, length), color=style.ORANGE, lw=0.9)
    ring = {"fill": False, "ec": style.INK, "lw": 1.3, "ls": (0, (4, 3))}
    axis.add_patch(Circle((0, 0), glass.lit_radius, **ring))
    axis.annotate(f"printable radius {glass.lit_radius:.2f} mm", (0, -glass.lit_radius), (-R * 1.5, -R * 1.12),
                  arrowprops={"arrowstyle": "-", "color": style.INK, "lw": 0.8}, va="center", fontsize=9)  # fmt: skip
    axis.set(xlim=(-1.55 * R, 1.35 * R), ylim=(-1.2 * R, 1.2 * R), aspect="equal", xlabel="along the light [mm]",
             ylabel="across the light [mm]", title="Rays at one angle")  # fmt: skip
    axis.grid(False)


def _chords(glass: Vial, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    chords = glass.chords(u)
    return chords.p, chords.angle, chords.length


def _path(R: float, u: float, p: float, d: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners of one ray (along, across) [mm]: before the vial, both faces, and out again by mirror symmetry."""
    middle, forth = p * np.array([np.sin(d), np.cos(d)]), np.array([np.cos(d), -np.sin(d)])
    start = np.array([[-2 * R, u], [-np.sqrt(R**2 - u**2), u]])
    mirrored = start - 2.0 * np.outer(start @ forth, forth)  # a ray leaves as it came, mirrored along its chord
    ends = middle + np.outer([-0.5 * length, 0.5 * length], forth)
    points = np.concatenate([start, ends, mirrored[::-1]])
    return points[:, 0], points[:, 1]


def _transmittance(axis: Axes, glass: Vial) -> list[Fact]:
    p = np.linspace(0.0, glass.lit_radius, 801)
    T = glass.chords(p * glass.resin_index / glass.bath_index).transmittance
    axis.plot(p, T, color=style.BLUE)
    low = float(np.interp(-0.8, -T, p))
    axis.axhline(0.8, color=style.RED, lw=1, ls=(0, (4, 3)))
    axis.plot(low, 0.8, "o", color=style.RED, ms=5)
    axis.text(low - 0.15, 0.77, f"0.8 at {low:.2f} mm", ha="right", va="top", color=style.RED)
    axis.set(xlabel="distance of the ray from the axis, in the resin [mm]", ylabel="transmitted share", ylim=(0, 1.02),
             xlim=(0, None), title="Fresnel transmittance of both faces")  # fmt: skip
    return [Fact("transmitted on the axis", float(T[0])), Fact("distance at which 0.8 is transmitted", low, "mm")]


def _density(axis: Axes, glass: Vial, n: int) -> list[Fact]:
    grid = np.linspace(-glass.inner_radius, glass.inner_radius, n)
    across, along = np.meshgrid(grid, grid, indexing="ij")
    _, weight = replace(glass, absorption=0.0).illuminate(across, along)
    weight[np.hypot(across, along) > glass.inner_radius] = np.nan
    pitch = 2.0 * glass.inner_radius / n
    drawn = style.shown(axis, weight.T, "Light at one angle, before absorption", pitch, vmin=0.5, vmax=3.0,
                        cmap=style.LIGHT)  # fmt: skip
    axis.set(xlabel="along the light [mm]", ylabel="across the light [mm]")
    axis.annotate("", (-0.55, 0.0), (-glass.inner_radius - 0.4, 0.0), annotation_clip=False,
                  arrowprops={"arrowstyle": "->", "color": "white", "lw": 1.2})  # fmt: skip
    style.bar(drawn, axis, "irradiance over that of the beam", extend="both")
    _, middle = replace(glass, absorption=0.0).illuminate(np.zeros(1), np.zeros(1))
    return [Fact("irradiance on the axis over that of the beam", float(middle[0]))]


def _flat_beam(axis: Axes, glass: Vial, device: Device, n: int) -> list[Fact]:
    grid = Grid((n, n, 1), 2.02 * glass.inner_radius / n)
    pixel = grid.pitch * max(glass.resin_index / glass.bath_index, 1.0)  # a column in the resin is as wide as a voxel
    beam, motion = Beam((2 * ceil(glass.aperture / pixel) + 2, 1), pixel), Turntable(2 * n)
    columns, slices = beam.pixels[0], beam.pitch / grid.pitch  # slices that share the light of a row
    light = np.ones((motion.angles, columns, 1))
    gathered = slices * Projection(grid, beam, motion, glass, device).T(light)[..., 0]
    scattered = deposit(glass, beam.columns(), light[..., 0], motion.poses, grid.shape[:2], grid.pitch)
    scattered *= grid.voxel_volume
    reach, edges = np.hypot(*np.meshgrid(*(centers(n, grid.pitch),) * 2)), np.linspace(0, glass.inner_radius, n // 4)
    radius, inner = _profile(reach, gathered / motion.angles, edges)
    _, whole = _profile(reach, scattered / motion.angles, edges)
    unit = grid.pitch**2 / beam.pitch
    inside = radius < glass.lit_radius - 2 * grid.pitch
    axis.plot(radius, whole / unit, color=style.ORANGE, lw=3.5, alpha=0.55, label="every ray scattered")
    axis.plot(radius[inside], inner[inside] / unit, color=style.BLUE, label="back projection")
    axis.axvline(glass.lit_radius, color=style.INK, lw=1, ls=(0, (4, 3)))
    axis.set(xlabel="distance from the axis [mm]", ylabel="absorbed power over irradiance [1/mm]",
             ylim=(0, None), xlim=(0, glass.inner_radius), title="Dose of a flat beam after a full turn")  # fmt: skip
    axis.legend(loc="lower left")
    gap = float(np.abs(inner[inside] / whole[inside] - 1.0).max())
    lost = _lost(glass, beam, scattered, motion)
    return [Fact("energy scattered over energy absorbed, deviation from 1", lost, "", 2, 1e-3, bound="≤"),
            Fact("largest gap between back projection and scatter inside the printable radius", 100 * gap, "%", 2),
            Fact("dose at the printable radius over dose on the axis", float(inner[inside][-1] / inner[0])),
            ]  # fmt: skip


def _profile(reach: np.ndarray, plane: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of a plane over rings."""
    total, _ = np.histogram(reach, edges, weights=plane)
    count, _ = np.histogram(reach, edges)
    return 0.5 * (edges[1:] + edges[:-1]), total / np.maximum(count, 1)


def _lost(glass: Vial, beam: Beam, scattered: np.ndarray, motion: Turntable) -> float:
    """|Σ deposited / Σ T·(1 − e^(−αL)) − 1| of a flat beam."""
    chords = glass.chords(beam.columns())
    share: Any = chords.transmittance * -np.expm1(-glass.absorption * chords.length)
    return abs(float(scattered.sum() / (motion.angles * share.sum())) - 1.0)
