"""Beams that are not ideal: their light, compared with formulas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.operators.defocus import Defocus, Defocused
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.oblique import Oblique
from vamgpu.operators.projection import Projection
from vamgpu.operators.shifts import Tiles, Wobbled
from vamgpu.operators.wobble import Wobble
from vamgpu.optics.beams import Fan, Misaligned
from vamgpu.optics.occluder import Occluded
from vamgpu.optics.rising_beams import Cone, Inclined
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PITCH = 0.1
"""Pitch of the beam [mm]; voxels are half as large."""
WAVELENGTH = 442e-6


def beams(
    device: Device,
    quick: bool = False,
    throw: float = 25.0,
    elevation: float = 0.35,
    fwhm: float = 0.0324,
    depth_of_focus: float = 3.8,
) -> Picture:
    """Eight imperfections of one beam."""
    n = 40 if quick else 120
    figure, axes = style.sheet("abcd;efgh", 5.6)
    facts = [
        *_fan(axes["a"], device, n, throw), *_cone(axes["b"], device, n, throw),
        *_inclined(axes["c"], device, n, elevation),
        *_rod(axes["d"], device, n, throw), *_aimed(axes["e"], device, n), *_wobble(axes["f"], device, n),
        *_defocus(axes["g"], device, fwhm, depth_of_focus, quick), *_tiles(axes["h"], device),
    ]  # fmt: skip
    caption = (
        "Light of one angle, travelling upwards. A pupil at a finite distance spreads the columns into a fan, or "
        "columns and rows into a cone; inclined light climbs through the slices; a rod in the light casts a shadow. "
        "Columns off the axis and a wobbling axis shift every image by fractions of a pixel. Away from the focus a "
        "pixel widens. Two numbers describe this, its width in focus and its depth of focus; the beam quality M² links "
        "them. A slightly misplaced tile leaves a seam: the wider the overlap, the weaker the seam. The lens also "
        "blurs it. Each of these is an operator with its exact transpose."
    )
    return Picture(figure, caption, tuple(facts))


def _shine(A: LinearOperator, columns: slice, row: int | slice = slice(None)) -> np.ndarray:
    """Dose of some columns at pose 0, whose light travels towards -x."""
    light = np.zeros(A.range.shape)
    light[0, columns, row] = 1.0
    return A.T(light)


def _seen(axis: Axes, plane: np.ndarray, title: str, label: str = "r [mm]") -> None:
    style.shown(axis, plane[:, ::-1], title, 0.5 * PITCH, cmap=style.LIGHT)
    axis.set(xlabel=label, ylabel="along the light [mm]")


def _geometry(n: int, slices: int = 2) -> tuple[Grid, Beam, Turntable]:
    return Grid((n, n, slices), 0.5 * PITCH), Beam((n // 2, max(slices // 2, 1)), PITCH), Turntable(1)


def _middle(profile: np.ndarray) -> float:
    """Mean place of light along an axis of voxels [mm]."""
    place = (np.arange(len(profile)) - 0.5 * (len(profile) - 1)) * 0.5 * PITCH
    return float((profile * place).sum() / profile.sum())


def _fan(axis: Axes, device: Device, n: int, throw: float) -> list[Fact]:
    dose = _shine(Projection(*_geometry(n), Fan(throw=throw), device), slice(2, None, 4))[..., 0]
    _seen(axis, dose.T, "Fan")
    u = 0.5 * PITCH * (n // 2 - 1 - 2 * (n // 10))
    single = _shine(Projection(*_geometry(n), Fan(throw=throw), device), slice(n // 2 - 1 - n // 10, n // 2 - n // 10))
    places = [_middle(single[i, :, 0]) for i in (-2, 1)]
    depth = (n - 3.0) * 0.5 * PITCH
    return [Fact("fan: lateral spread of a column at r, divided by the volume's depth", (places[1] - places[0]) / depth,
                 "", expected=u / throw, source="r / throw")]  # fmt: skip


def _cone(axis: Axes, device: Device, n: int, throw: float) -> list[Fact]:
    A = Oblique(*_geometry(n, n), Cone(throw=throw), device=device)
    dose = _shine(A, slice(n // 4 - 1, n // 4 + 1), slice(2, None, 4))
    _seen(axis, dose[:, n // 2 - 1].T, "Cone from the side", "z [mm]")
    even = _shine(A, slice(None))[:, n // 2, n // 2]
    reach = 0.5 * (n - 1) * 0.5 * PITCH
    return [Fact("cone: irradiance nearest the pupil divided by farthest", float(even[-1] / even[0]),
                 expected=((throw + reach) / (throw - reach)) ** 2, source="distance²")]  # fmt: skip


def _inclined(axis: Axes, device: Device, n: int, elevation: float) -> list[Fact]:
    A = Oblique(*_geometry(n, n), Inclined(elevation=elevation), device=device)
    dose = _shine(A, slice(None), slice(2, None, 4))[:, n // 2]
    _seen(axis, dose.T, "Inclined, from the side", "z [mm]")
    row = _shine(A, slice(None), n // 4)[:, n // 2]
    low, high = n // 3, n - n // 3
    climb = (_middle(row[low]) - _middle(row[high])) / ((high - low) * 0.5 * PITCH)
    return [Fact("inclined: climb of a row", float(np.degrees(np.arctan(climb))), "°",
                 expected=float(np.degrees(elevation)), source="elevation")]  # fmt: skip


def _rod(axis: Axes, device: Device, n: int, throw: float) -> list[Fact]:
    rod = Occluded(Fan(throw=throw), across=0.5, along=-0.4, radius=0.25)
    dose = _shine(Projection(*_geometry(n), rod, device), slice(None))[..., 0]
    _seen(axis, dose.T, "Rod in a fan")
    dark = float((dose[1] < 0.5 * np.median(dose[1])).sum()) * 0.5 * PITCH
    edge = 0.5 * (n - 3) * 0.5 * PITCH
    wanted = 2.0 * 0.25 * (throw + edge) / (throw - 0.4)
    return [Fact("rod: width of its shadow at the far side", dark, "mm", 3, wanted, "radius and throw")]


def _aimed(axis: Axes, device: Device, n: int) -> list[Fact]:
    grid, beam, _ = _geometry(n)
    offset, motion = 0.237, Turntable(60)
    x = np.exp(-0.5 * sum(a**2 for a in np.meshgrid(*grid.axes(), indexing="ij")) / 0.3**2)
    image = Projection(grid, beam, motion, Misaligned(offset=offset), device)(x).sum(axis=2)
    found = float((image.sum(axis=0) * beam.columns()).sum() / image.sum())
    axis.plot(beam.columns(), image[0], color=style.ORANGE)
    axis.axvline(found, color=style.INK, lw=1, ls=(0, (4, 3)))
    axis.set(xlabel="r [mm]", title="Rod, aimed beside the axis", ylabel="path")
    return [Fact("offset of the axis, found in the sinogram", 1e3 * found, "µm", expected=1e3 * offset, source="set")]


def _wobble(axis: Axes, device: Device, n: int) -> list[Fact]:
    grid, beam, _ = _geometry(n)
    motion = Turntable(90)
    x = np.exp(-0.5 * sum(a**2 for a in np.meshgrid(*grid.axes(), indexing="ij")) / 0.3**2)
    wobble = Wobble.circle(0.5, 0.4, motion)
    image = Wobbled(Projection(grid, beam, motion, device=device), wobble)(x).sum(axis=2)
    style.shown(axis, image, "Rod, the axis wobbles", cmap=style.LIGHT, aspect="auto")
    found = (image * beam.columns()).sum(axis=1) / image.sum(axis=1)
    gap = float(np.abs(found - wobble.across).max())
    return [Fact("wobble: largest gap between the image's middle and the axis", 1e3 * gap, "µm", 2, 1.0, bound="≤")]


def _defocus(axis: Axes, device: Device, fwhm: float, depth_of_focus: float, quick: bool) -> list[Fact]:
    meant = Defocus(fwhm, depth_of_focus)
    pixel, depths = fwhm / 4.0, 21 if quick else 41
    focused = Defocus(fwhm, 0.1 * pixel * depths)  # as deep as a volume of few voxels can show
    grid, beam = Grid((depths, 121, 3), 0.25 * pixel), Beam((47, 47), pixel)
    A = Defocused(Projection(grid, beam, Turntable(1), device=device), focused)
    dose = _shine(A, slice(23, 24))[..., 1]
    x, y, _ = grid.axes()
    fine = np.linspace(y[0], y[-1], 20001)
    found = np.array([np.ptp(fine[np.interp(fine, y, row) >= 0.5 * row.max()]) for row in dose])
    wanted, depth = focused.width(-x), -x / focused.depth_of_focus
    axis.plot(depth, 1e3 * wanted, color=style.ORANGE, lw=3.5, alpha=0.55, label="formula")
    axis.plot(depth, 1e3 * found, color=style.BLUE, label="measured")
    axis.set(xlabel="depth over depth of focus", ylabel="FWHM of a pixel [µm]", title="Out of focus", ylim=(0, None))
    axis.legend(loc="lower left")
    gap = float(np.abs(found / wanted - 1.0).max())
    return [Fact("width of a pixel against the formula, largest gap", 100 * gap, "%", 2, 2.2, bound="≤"),
            Fact("beam quality M² of the two numbers at 442 nm", meant.quality(WAVELENGTH), "", 3, 2.8,
                 "10.8 mm of an ideal beam over 3.8 mm")]  # fmt: skip


def _tiles(axis: Axes, device: Device) -> list[Fact]:
    grid, tall, motion = Grid((12, 12, 40), PITCH), Beam((14, 40), PITCH), Turntable(6)
    A = Projection(grid, tall, motion, device=device)
    even = np.ones(A.range.shape)
    plain, z, seams = A.T(even), grid.axes()[2], []
    for rows, center, color in ((22, 1.1, style.RED), (30, 0.7, style.GREEN)):
        meant, real = (Tiles(A, rows, 0, [-center, center - late]) for late in (0.0, 0.04))
        dose = (real.T(meant.split(even)) / np.maximum(plain, 1e-9))[6, 6]
        overlap = 2 * (rows * PITCH / 2 - center)
        axis.plot(z[4:-4], dose[4:-4], color=color, label=f"overlap {overlap:.1f} mm")
        seams.append(100 * float(np.abs(dose[4:-4] - 1.0).max()))
    tiles = Tiles(A, rows=17, overlap=5)
    exact = float(np.abs(tiles.T(tiles.split(even)) - plain).max() / plain.max())
    axis.set(xlabel="z [mm]", ylabel="dose over the tall beam's", title="Tiles, one 40 µm off")
    axis.legend(loc="upper left")
    return [Fact("seam of tiles that only touch, 0.4 rows off", seams[0], "%", 3, 40.0, "0.4 of a row, without blur"),
            Fact("seam of tiles that overlap by 1.6 mm", seams[1], "%", 3, 2.5, "40 µm / 1.6 mm"),
            Fact("tiles in place: difference from the tall beam, divided by its dose", exact, "", 2, 2e-6,
                 bound="≤")]  # fmt: skip
