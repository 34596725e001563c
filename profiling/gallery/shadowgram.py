"""A print seen by a camera behind it: the shadow of cured resin at three planes of focus."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.geometry import Grid, centers
from vamgpu.optics.shadowgram import Camera, cured_index
from vamgpu.optics.shadowgram import shadowgram as shadow
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def shadowgram(
    device: Device, quick: bool = False, contrast: float = 2e-3, resin_index: float = 1.48, focus: float = 8.0,
    pose: float = 30.0,
) -> Picture:  # fmt: skip
    """A gyroid cut to a ball; focus [mm] behind the axis, angle in degrees."""
    n = 32 if quick else 96
    grid = Grid((n, n, n), 12.0 / n)
    cured = _gyroid(grid, radius=4.2, cell=3.0)
    field = cured_index(cured, grid, resin_index, contrast)
    camera, theta = Camera((n, n), 11.0 / n, focus), np.radians(pose)
    figure, axes = style.sheet("abc;dde", 7.0, width_ratios=[1.0, 1.0, 1.0])
    style.shown(axes["a"], cured[:, :, n // 2], "Cured resin, middle slice", grid.pitch, cmap=style.SOLID)
    lost, contrasts = 0.0, {}
    for letter, at in (("b", 0.25 * focus), ("c", focus), ("e", -focus)):
        seen = shadow(field, Camera(camera.pixels, camera.pitch, at), resin_index, pose=theta, rays=2, device=device)
        drawn = style.shown(axes[letter], seen.image, f"Focus {at:+.3g} mm", camera.pitch, cmap="gray", vmin=0.4,
                            vmax=1.8)  # fmt: skip
        inner = seen.image[n // 4 : -n // 4, n // 4 : -n // 4]
        contrasts[at] = float(inner.std() / inner.mean())
        lost = max(lost, abs(seen.image.sum() + seen.lost - seen.light) / seen.light)
    style.bar(drawn, axes["e"], "light over that without a print")
    gap = _weak_blob(axes["d"], device, resin_index, quick)
    facts = (
        Fact("deflection by a weak blob against ∫∇n dY / n, largest gap", 100 * gap, "%", 2, 1.0, bound="≤"),
        Fact("light unaccounted for", lost, "", 1, 1e-9, bound="≤"),
        *(Fact(f"contrast of the image at a focus of {at:+.3g} mm", value, "", 3) for at, value in contrasts.items()),
    )
    caption = (
        "Cured resin has a slightly higher index and bends parallel light: behind the print, rays are denser in some "
        "places and sparser in others. Every pixel counts the rays that meet it in the plane on which its lens is "
        "focused. Near the print the shadow is faint; farther away it grows; in front of the print dark and bright are "
        "exchanged. The curve compares the deflection by a faint Gaussian blob from ray marching with the integral of "
        "the index gradient."
    )
    return Picture(figure, caption, facts)


def _gyroid(grid: Grid, radius: float, cell: float) -> np.ndarray:
    """A gyroid sheet inside a ball, with borders as soft as a voxel."""
    x, y, z = (a * 2.0 * np.pi / cell for a in np.meshgrid(*grid.axes(), indexing="ij", sparse=True))
    level = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    away = np.sqrt(sum(a**2 for a in np.meshgrid(*grid.axes(), indexing="ij", sparse=True)))
    soft = 2.0 * np.pi / cell * grid.pitch
    sheet = np.clip((0.5 - np.abs(level)) / soft + 0.5, 0.0, 1.0)
    return sheet * np.clip((radius - away) / (2.0 * grid.pitch) + 0.5, 0.0, 1.0)


def _weak_blob(axis: Axes, device: Device, resin_index: float, quick: bool) -> float:
    n, width, contrast = (49, 0.5, 2e-4) if quick else (97, 0.5, 2e-4)
    x = centers(n, 6.0 / (n - 1))
    blob = np.exp(-((x[:, None] - 0.4) ** 2 + (x + 0.3) ** 2) / (2.0 * width**2))
    field = cured_index(blob[:, :, None], Grid((n, n, 1), 6.0 / (n - 1)), resin_index, contrast)
    seen = shadow(field, Camera((60, 1), 0.09), resin_index, device=device)
    away = seen.start[:, 0] + 0.3
    want = -away / width**2 * contrast / resin_index * width * np.sqrt(2.0 * np.pi) * np.exp(-0.5 * (away / width) ** 2)
    axis.plot(seen.start[:, 0], 1e3 * seen.deflection[:, 0], color=style.ORANGE, lw=3.5, alpha=0.55, label="marched")
    axis.plot(seen.start[:, 0], 1e3 * want, color=style.BLUE, label="integral of the slope")
    axis.set(title="Deflection by a weak blob", xlabel="across the light [mm]", ylabel="deflection [mrad]")
    axis.legend()
    return float(np.abs(seen.deflection[:, 0] - want).max() / np.abs(want).max())
