"""The view of a camera behind a print: cured resin bends light, and the image is bright where rays are dense."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Grid, centers, counts, positive
from vamgpu.optics.index_field import GridField, Region
from vamgpu.optics.inputs import Floats
from vamgpu.optics.march import march
from vamgpu.schema import check
from vamgpu.schema.quantities import Index, Length, Place, Positive, measured

MARGIN = 2  # pixels by which the light is wider than the camera; its rim is then lit like its middle


@dataclass(frozen=True)
class Camera:
    """A camera behind a telecentric lens, centered on the axis; lengths as in the resin. Raises `BadInput`."""

    # pixels: across (X) and up (z). pitch: of a pixel [mm]. focus: distance of the focal plane behind the axis [mm]; at
    # the print itself, the shadow vanishes. aperture: sine of the steepest ray that the lens accepts.

    pixels: tuple[int, int]
    pitch: Length
    focus: Place = 0.0
    aperture: Positive = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", counts("Camera pixels", self.pixels, 2))
        check(self)


@dataclass(frozen=True, eq=False)
class Shadowgram:
    """A camera image (pixels across, pixels up), relative to that without a print, and its rays."""

    # light: all light sent, in pixels of an image without a print. lost: light that missed the camera or its aperture:
    # image.sum() + lost = light. start: X and z of the rays in front of the print [mm], (rays, 2). deflection: dX/dY
    # and dz/dY behind it, (rays, 2).

    image: Floats
    light: float
    lost: float
    start: Floats
    deflection: Floats


def cured_index(cured: ArrayLike, grid: Grid, resin_index: float, contrast: float) -> GridField:
    """The index resin_index + contrast × cured [x, y, z]; < 4 slices are averaged. Raises `BadInput`."""
    values = np.asarray(cured, np.float64)
    if values.shape != grid.shape:
        raise ShapeMismatch(f"the cured field has shape {values.shape}, the grid {grid.shape}; make them equal")
    if grid.shape[2] < 4:
        values = values.mean(axis=2)
    return GridField.from_array(measured("resin_index", resin_index, Index) + contrast * values, grid.pitch)


def shadowgram(
    field: GridField, camera: Camera, resin_index: float, *, pose: float = 0.0, rays: int = 3,
    step: float | None = None, device: str | Device | None = None,
) -> Shadowgram:  # fmt: skip
    """The shadow of a print that turns in resin of one index, lit by parallel light.

    Parallel rays enter the largest upright cylinder inside the grid and are marched through it. They then travel to the
    plane of the camera's focus and divide their light among the pixels around. Rays beside the cylinder are unchanged.

    Args:
        field: Index in the print's own frame; at the cylinder's border it must be resin_index.
        camera: The camera; for a field of only x and y, use a camera with one row of pixels.
        resin_index: Refractive index around the cylinder.
        pose: Angle θ of the print [rad].
        rays: Rays per pixel and axis.
        step: Step of ∫ds/n [mm]; by default a third of the grid's pitch, divided by the index.
        device: A name or a device.

    Returns:
        The image, and the rays that form it.

    Raises:
        BadInput: An argument is of another type or out of its range.
        RayError: A ray never leaves.
    """
    if not isinstance(field, GridField):
        raise BadInput(f"got {field!r} for the print; expected a GridField, as made by cured_index")
    flat = field.coefficients.ndim == 2
    if flat and camera.pixels[1] != 1:
        raise BadInput(f"a field of x and y lights one row of pixels; the camera has {camera.pixels[1]}")
    radius = min(-field.corner[0], -field.corner[1])
    n = measured("resin_index", resin_index, Index)
    (rays,) = counts("rays", (rays,), 1)
    across = centers((camera.pixels[0] + 2 * MARGIN) * rays, camera.pitch / rays)
    up = np.zeros(1) if flat else centers((camera.pixels[1] + 2 * MARGIN) * rays, camera.pitch / rays)
    start = np.stack([g.ravel() for g in np.meshgrid(across, up, indexing="ij")], axis=1)
    place, heading = _before(start, radius, pose), np.array([-np.cos(pose), -np.sin(pose), 0.0])
    through = np.abs(start[:, 0]) < radius * (1.0 - 1e-6)
    ends, slopes = place.copy(), np.tile(heading, (len(start), 1))
    if through.any():
        medium = replace(field, region=Region.cylinder(radius))
        size = positive("step [mm]", step) if step is not None else field.pitch / (3.0 * n)
        out = march(medium, place[through], slopes[through], step=size, device=device)
        ends[through], slopes[through] = out.place, out.direction
    return _seen(start, ends, slopes, camera, pose, 1.0 / (rays if flat else rays**2))


def _before(start: Floats, radius: float, pose: float) -> Floats:
    """Positions where rays meet the cylinder, or pass its middle, in the print's frame."""
    along = -np.sqrt(np.maximum((radius - start[:, 0]) * (radius + start[:, 0]), 0.0))
    c, s = np.cos(pose), np.sin(pose)
    return np.stack([-start[:, 0] * s - along * c, start[:, 0] * c - along * s, start[:, 1]], axis=1)


def _seen(start: Floats, place: Floats, direction: Floats, camera: Camera, pose: float, share: float) -> Shadowgram:
    c, s = np.cos(pose), np.sin(pose)
    across, along = place[:, 1] * c - place[:, 0] * s, -(place[:, 0] * c + place[:, 1] * s)
    aside, ahead = direction[:, 1] * c - direction[:, 0] * s, -(direction[:, 0] * c + direction[:, 1] * s)
    deflection = np.stack([aside, direction[:, 2]], axis=1) / ahead[:, None]
    seen = (ahead > 0) & (np.hypot(aside, direction[:, 2]) <= camera.aperture)
    meets = np.stack([across, place[:, 2]], axis=1) + (camera.focus - along)[:, None] * deflection
    image = share * _shared(meets[seen] / camera.pitch, camera.pixels)
    light = share * len(start)
    return Shadowgram(image, light, float(light - image.sum()), start, deflection)


def _shared(at: Floats, pixels: tuple[int, int]) -> Floats:
    """Rays per pixel. Each is divided among three pixels along each axis by quadratic B-splines, which are smooth."""
    total = np.zeros(pixels)
    shares = []
    for axis, count in enumerate(pixels):
        position = at[:, axis] + 0.5 * (count - 1)
        near = np.floor(position + 0.5).astype(np.int64)
        f = position - near
        if count == 1:  # a single row collects all light that meets it
            shares.append([(near, np.ones_like(f))])
            continue
        weights = (0.5 * (0.5 - f) ** 2, 0.75 - f**2, 0.5 * (0.5 + f) ** 2)
        shares.append([(near + k, w) for k, w in zip((-1, 0, 1), weights, strict=True)])
    for column, wx in shares[0]:
        for row, wz in shares[1]:
            inside = (column >= 0) & (column < pixels[0]) & (row >= 0) & (row < pixels[1])
            flat = column[inside] * pixels[1] + row[inside]
            total += np.bincount(flat, (wx * wz)[inside], minlength=total.size).reshape(pixels)
    return total
