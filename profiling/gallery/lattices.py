"""Periodic solids for endless webs, and a lattice thicker than the film, cut along a spiral."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from profiling.gallery.render import rendered
from vamgpu.backend.device import Device
from vamgpu.geometry import Grid
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.printing.surface import iso_surface
from vamgpu.reports import style
from vamgpu.targets.implicit import voxelize
from vamgpu.targets.lattices import (
    Capsules,
    CubicLattice,
    OctetTruss,
    Pentamode,
    SchwarzP,
    SheetGyroid,
    SkeletalDiamond,
    SkeletalGyroid,
)
from vamgpu.targets.solid import Solid
from vamgpu.targets.spiral import Spiral
from vamgpu.web import WebGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER = {"SheetGyroid": 32.4, "SkeletalGyroid": 9.9, "SkeletalDiamond": 20.7}
"""Volume fractions [%] of the paper's levels."""
SPIRAL = Spiral(inner=2.0, thickness=1.5, turns=3.0)


def lattices(device: Device, quick: bool = False, cell: float = 3.0, cells: float = 2.0) -> Picture:
    """``cell`` of every lattice [mm]; ``cells`` along each edge of the drawn cubes."""
    del device  # functions of space are sampled by NumPy
    n = 24 if quick else 72
    shapes = _shapes(cell)
    names = [type(shape).__name__ for shape in shapes]
    figure, axes = style.sheet([names[:4], names[4:], ["wound", "wound", "film", "film"]], 8.6)
    rows = []
    for name, shape in zip(names, shapes, strict=True):
        box = Grid((n, n, n), cells * cell / n)
        cube = voxelize(shape, box)
        surface = iso_surface(cube, 0.5, box.pitch)
        axes[name].imshow(rendered(Solid(surface.points, surface.faces), 60 if quick else 250), interpolation="nearest")
        axes[name].set_title(name)
        axes[name].grid(False)
        style.bare(axes[name])
        rows.append((name, (100.0 * _filled(shape, cell, 2 * n // 3), *_pieces(cube))))
    facts = [
        Fact(f"volume of {name}", row[0], "%", 3, PAPER[name], "the paper's level")
        for name, row in rows if name in PAPER
    ]  # fmt: skip
    facts.append(_wound(axes["wound"], axes["film"], 0.2 if quick else 0.08))
    table = Table(("shape", "volume of a period [%]", "pieces in the drawn cube", "largest piece [%]"),
                  (".2f", ".0f", ".1f"), tuple(rows))  # fmt: skip
    caption = (
        "Solids as functions of space, negative inside: four triply periodic minimal surfaces at the levels of the "
        "roll-to-roll paper (Schwarz P at 0.8, below its pinch-off), three trusses and closed capsules, with cells of "
        f"{cell:g} mm, {cells:g} along each edge. Except for the capsules, pieces beyond the first are ends that the "
        f"cube cuts off. Below, an octet truss of 4 mm cells in a body {2 * SPIRAL.outer:.1f} mm across, far thicker "
        f"than the {SPIRAL.thickness:g} mm film: a spiral cuts it into {SPIRAL.length:.1f} mm of flat film, and "
        "winding that film up restores it."
    )
    return Picture(figure, caption, tuple(facts), table, (ROLL_TO_ROLL,))


def _shapes(cell: float) -> tuple[Any, ...]:
    share = cell / 3.0
    return (
        SheetGyroid(cell), SkeletalGyroid(cell), SchwarzP(cell), SkeletalDiamond(cell), CubicLattice(cell, 0.5 * share),
        OctetTruss(cell, 0.3 * share), Pentamode(cell, 0.2 * share, 0.6 * share),
        Capsules(0.6 * share, 0.6 * share, 0.2 * share, (2.4 * share, 1.6 * share), 0.0),
    )  # fmt: skip


def _filled(shape: Any, cell: float, n: int) -> float:
    """Volume fraction of one period."""
    if isinstance(shape, Capsules):
        (a, c), b = shape.spacing, 2.2 * shape.radius
        web = WebGrid((n, n, n), (a / n, b / n, c / n))
        return float(voxelize(lambda x, y, z: shape(x, y - 0.5 * b, z), web, samples=2).mean())
    return float(voxelize(shape, Grid((n, n, n), cell / n)).mean())


def _pieces(cube: np.ndarray) -> tuple[float, float]:
    """How many pieces a cube of voxels holds, and the share [%] of the largest."""
    from scipy.ndimage import label

    piece: np.ndarray = label(cube > 0, np.ones((3, 3, 3)))[0]  # type: ignore[index]
    size = np.bincount(piece.ravel())[1:]
    return float(len(size)), 100.0 * float(size.max()) / float(size.sum())


def _wound(body: Axes, flat: Axes, pitch: float) -> Fact:
    """A truss cut into film and wound again; draws one plane of both."""
    shape = OctetTruss(4.0, 1.0)
    n = 2 * int(np.ceil(SPIRAL.outer / pitch)) + 2
    grid, web = Grid((n, n, 4), pitch), SPIRAL.web(pitch, 4 * pitch)
    solid, film = voxelize(shape, grid, samples=5), voxelize(SPIRAL.film(shape), web, samples=5)
    again = SPIRAL.wind(film, web, grid)
    x, y, _ = grid.axes()
    _, _, held = SPIRAL.flat(x[:, None], y[None, :])
    one, other = (solid >= 0.5) & held[..., None], (again >= 0.5) & held[..., None]
    seen = again[:, :, 2] + 0.12 * held
    style.shown(body, seen, "The film wound up again", pitch, cmap=style.SOLID, vmin=0, vmax=1.2)
    psi = np.linspace(0.0, SPIRAL.end, 1500)
    line = SPIRAL.inner + SPIRAL.rise * psi
    body.plot(line * np.cos(psi), line * np.sin(psi), color=style.RED, lw=0.9)
    body.set(xlabel="x [mm]", ylabel="y [mm]")
    rows = 6
    part = -(-web.shape[0] // rows)
    padded = np.zeros((part * rows, web.shape[1] + max(2, web.shape[1] // 4)), np.float32)
    padded[: web.shape[0], : web.shape[1]] = film[:, :, 2]
    seen = np.zeros_like(padded)
    seen[: web.shape[0], : web.shape[1]] = 0.12
    strips = (padded + seen).reshape(rows, part, -1)[::-1].transpose(1, 0, 2).reshape(part, -1)
    flat.imshow(strips.T, origin="lower", cmap=style.SOLID, vmin=0, vmax=1.2, interpolation="nearest",
                extent=(0, part * pitch, 0, strips.shape[1] * pitch))  # fmt: skip
    flat.set(title="The flat film, cut into six strips, first on top", xlabel="l [mm]", yticks=[])
    flat.grid(False)
    return Fact("overlap (IoU) of the wound film with the solid", float((one & other).sum() / (one | other).sum()),
                expected=0.99, bound="≥")  # fmt: skip
