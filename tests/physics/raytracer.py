"""Light traced ray by ray in float64, from Snell's, Fresnel's and Beer-Lambert's laws alone.

At the pose t a ray starts at u·(−sin t, cos t), far towards the source at +(cos t, sin t), and travels towards
−(cos t, sin t); positions are those of the voxels, so nothing here is in any laboratory frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import vamgpu as vam

FAR = 1e3
Phantom = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Rays:
    """Straight pieces in the resin: where they begin, which way they go, how far [mm], and the power that came in."""

    start: np.ndarray
    heading: np.ndarray
    length: np.ndarray
    power: np.ndarray

    def at(self, s: np.ndarray) -> np.ndarray:
        """Points [..., 2] after the path s."""
        return self.start + s[..., None] * self.heading


def enter(start: np.ndarray, heading: np.ndarray, radius: float) -> np.ndarray:
    """First point of each ray on a circle about the axis; NaN where it misses."""
    along = np.sum(start * heading, axis=-1)
    with np.errstate(invalid="ignore"):
        distance = -along - np.sqrt(along**2 - np.sum(start**2, axis=-1) + radius**2)
    return start + distance[..., None] * heading


def refract(heading: np.ndarray, normal: np.ndarray, before: float, after: float) -> tuple[np.ndarray, np.ndarray]:
    """Snell's law for vectors, normal against the light: new heading, Fresnel's shares of s and p light [..., 2]."""
    cos_in = -np.sum(heading * normal, axis=-1)
    sin_out = (before / after) * (heading + cos_in[..., None] * normal)
    with np.errstate(invalid="ignore"):
        cos_out = np.sqrt(1.0 - np.sum(sin_out**2, axis=-1))
    s = ((before * cos_in - after * cos_out) / (before * cos_in + after * cos_out)) ** 2
    p = ((after * cos_in - before * cos_out) / (after * cos_in + before * cos_out)) ** 2
    return sin_out - cos_out[..., None] * normal, 1.0 - np.stack([s, p], axis=-1)


def through_vial(vial: vam.Vial, start: np.ndarray, heading: np.ndarray) -> Rays:
    """Rays behind both faces of the wall; power 0 where they miss the resin."""
    shares = np.ones((*start.shape[:-1], 2))
    inner = vial.radius - vial.wall
    for radius, before, after in (
        (vial.radius, vial.bath_index, vial.wall_index),
        (inner, vial.wall_index, vial.resin_index),
    ):
        start = enter(start, heading, radius)
        heading, share = refract(heading, start / radius, before, after)
        shares = shares * share
    power = shares @ {"none": [0.5, 0.5], "s": [1.0, 0.0], "p": [0.0, 1.0]}[vial.polarization]
    length = -2.0 * np.sum(start * heading, axis=-1)
    missed = np.isnan(power)
    return Rays(np.where(missed[..., None], 0.0, start), np.where(missed[..., None], 0.0, heading),
                np.where(missed, 0.0, length), np.where(missed, 0.0, power))  # fmt: skip


def through_vat(vat: vam.Vat, start: np.ndarray, heading: np.ndarray) -> Rays:
    """Rays behind the flat window of a square vat, half its width from the axis, or of its round vessel."""
    power = np.ones(start.shape[:-1])
    for before, after in ((vat.bath_index, vat.wall_index), (vat.wall_index, vat.resin_index)):
        power = power * (1.0 - ((before - after) / (before + after)) ** 2)
    along = np.sum(start * heading, axis=-1)
    across = start - along[..., None] * heading
    half = np.full(along.shape, 0.5 * vat.width)
    if vat.radius is not None:
        half = np.sqrt(np.maximum(vat.radius**2 - np.sum(across**2, axis=-1), 0.0))
    return Rays(across - half[..., None] * heading, heading, 2.0 * half, np.where(half > 0, power, 0.0))


def trace(vessel: vam.Vial | vam.Vat | None, angle: np.ndarray, u: np.ndarray) -> Rays:
    """The rays of columns at u [mm] at the poses `angle`; arrays of one shape."""
    angle, u = np.broadcast_arrays(angle, u)
    heading = -np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    start = u[..., None] * np.stack([-np.sin(angle), np.cos(angle)], axis=-1) - FAR * heading
    if isinstance(vessel, vam.Vial):
        return through_vial(vessel, start, heading)
    if isinstance(vessel, vam.Vat):
        return through_vat(vessel, start, heading)
    return Rays(start, heading, np.full(u.shape, 2.0 * FAR), np.ones(u.shape))


def projected(A: vam.Projection, phantom: Phantom, reach: float, step: float) -> np.ndarray:
    """Power × ∫ phantom ds along every ray, or × ∫ phantom·a·exp(−a·s) ds; [angle, r, z] by the midpoint rule.

    The phantom vanishes farther than `reach` [mm] from the axis.
    """
    (columns, rows), pitch = A.beam.pixels, A.beam.pitch
    u, z = ((np.arange(n) - 0.5 * (n - 1)) * pitch for n in (columns, rows))
    rays = trace(A.vessel, np.asarray(A.motion.poses)[:, None], u[None, :])  # type: ignore[arg-type]
    middle = -np.sum(rays.start * rays.heading, axis=-1)[..., None]
    count = int(np.ceil(2.0 * reach / step))
    s = middle + (np.arange(count) + 0.5 - 0.5 * count) * (2.0 * reach / count)
    points = rays.start[..., None, :] + s[..., None] * rays.heading[..., None, :]
    weight = rays.power[..., None] * (s > 0) * (s < rays.length[..., None]) * (2.0 * reach / count)
    if A.vessel is not None and A.vessel.absorption > 0:
        weight = weight * A.vessel.absorption * np.exp(-A.vessel.absorption * s)
    return np.stack([np.sum(weight * phantom(points[..., 0], points[..., 1], h), axis=-1) for h in z], axis=-1)


def ray_to(vessel: vam.Vial | vam.Vat | None, angle: np.ndarray, x: np.ndarray, y: np.ndarray, limit: float
           ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Offset u [mm] of the ray that meets (x, y) at each pose, found by bisection, and its absorbed share there.

    The share is power × rays per width × (a·exp(−a·path) where the vessel absorbs, else 1), per mm² of light in air.
    """

    def miss(u: np.ndarray) -> np.ndarray:
        rays = trace(vessel, angle, u)
        dx, dy = x - rays.start[..., 0], y - rays.start[..., 1]
        return rays.heading[..., 1] * dx - rays.heading[..., 0] * dy  # how far the point lies on the side of larger u

    low = np.full(np.broadcast(angle, x).shape, -limit)
    u, high = np.zeros_like(low), -low
    for _ in range(60):
        beyond = miss(u) > 0
        low, high = np.where(beyond, u, low), np.where(beyond, high, u)
        u = 0.5 * (low + high)
    rays, h = trace(vessel, angle, u), 1e-5
    share = rays.power / np.abs((miss(u + h) - miss(u - h)) / (2 * h))
    if vessel is not None and vessel.absorption > 0:
        path = np.hypot(x - rays.start[..., 0], y - rays.start[..., 1])
        share = share * vessel.absorption * np.exp(-vessel.absorption * path)
    return u, share
