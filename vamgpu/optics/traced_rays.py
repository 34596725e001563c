"""Rays traced through the media around the resin, row by row of the fixed frame: position, slope and irradiance.

Proofs use them. Solvers need the ray through a given point, proofs do not; see `vamgpu.optics.traced_pose`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Vessel
from vamgpu.optics.graded_vial import GradedVial
from vamgpu.optics.inputs import Floats, absorbed_share
from vamgpu.optics.interface import refract
from vamgpu.optics.occluder import Occluded
from vamgpu.optics.square_bath import SquareBath
from vamgpu.optics.vial import Vial

RAYS = 1025
"""Number of rays across the light of one angle: between rays 0.04 mm apart, a straight line is right to 5e-5 mm."""
BISECTIONS = 50


class Crossing(NamedTuple):
    """Rays (rays,) at a row Y: X across [mm], cosine to the light, share absorbed per mm (1 in clear resin)."""

    across: Floats
    cosine: Floats
    share: Floats


class Rays(Protocol):
    """Rays of one angle in ascending order of their columns u [mm], with the power that reaches the resin."""

    @property
    def u(self) -> Floats: ...

    @property
    def transmittance(self) -> Floats: ...

    def cross(self, along: Any) -> Crossing:
        """Where the rays cross the row Y = ``along`` [mm], or rows (rows, 1), continued straight beyond the resin."""
        ...


@dataclass(frozen=True, eq=False)
class StraightRays:
    """Straight rays (rays,): distance p of the chord [mm], cosine and sine of its turn, entry along the chord [mm]."""

    u: Floats
    transmittance: Floats
    p: Floats
    cosine: Floats
    sine: Floats
    entry: Floats
    absorption: float

    def cross(self, along: Any) -> Crossing:
        across = (self.p - along * self.sine) / self.cosine
        path = along * self.cosine - across * self.sine - self.entry if self.absorption > 0 else np.zeros_like(across)
        return Crossing(across, self.cosine, absorbed_share(self.absorption, path))


@dataclass(frozen=True, eq=False)
class BentRays:
    """Rays that bend in the resin, in steps: positions and path [mm], arrays (rays, steps), with rising ``along``."""

    u: Floats
    transmittance: Floats
    across: Floats
    along: Floats
    path: Floats
    absorption: float

    def cross(self, along: Any) -> Crossing:
        if np.ndim(along):
            return Crossing(*map(np.stack, zip(*map(self.cross, along.ravel().tolist()), strict=True)))
        step = np.clip((self.along < along).sum(axis=1) - 1, 0, self.along.shape[1] - 2)[:, None]
        x, y, path = (np.take_along_axis(a, step + [[0, 1]], axis=1) for a in (self.across, self.along, self.path))
        rise = np.maximum(y[:, 1] - y[:, 0], 1e-12)
        part = (along - y[:, 0]) / rise
        length = np.hypot(x[:, 1] - x[:, 0], rise)
        gone = path[:, 0] + part * length
        return Crossing(x[:, 0] + part * (x[:, 1] - x[:, 0]), rise / length, absorbed_share(self.absorption, gone))


@dataclass(frozen=True, eq=False)
class ShadedRays:
    """Rays that a rod partly blocks; offsets and transmittance are those without the rod."""

    u: Floats
    transmittance: Floats
    inner: Rays
    rod: Occluded

    def cross(self, along: Any) -> Crossing:
        rays, rod = self.inner.cross(along), self.rod
        sine = self._sine(rays.cosine, along)
        x, y = rays.across - rod.across, along - rod.along
        beside = np.abs(x * rays.cosine + y * sine)
        behind = y * rays.cosine - x * sine > -np.sqrt(np.maximum(rod.radius**2 - beside**2, 0.0))
        return rays._replace(share=np.where((beside < rod.radius) & behind, rod.transmittance, 1.0) * rays.share)

    def _sine(self, cosine: Floats, along: Any) -> Floats:
        """Signed sine of the rays' turn; the sign follows from their direction."""
        drift = self.inner.cross(along + 1e-3).across - self.inner.cross(along).across
        return -np.sign(drift) * np.sqrt(np.maximum(1.0 - cosine**2, 0.0))


def traced_rays(vessel: Vessel | None, reach: float, rays: int = RAYS) -> Rays:
    """Rays of one angle, from columns within ``reach`` [mm] of the middle. Raises `BadInput` if none enters resin."""
    if vessel is None:
        u = np.linspace(-reach, reach, rays)
        return StraightRays(u, np.ones(rays), u, np.ones(rays), np.zeros(rays), np.zeros(rays), 0.0)
    if isinstance(vessel, Occluded):
        inner = traced_rays(vessel.vessel, reach, rays)
        return ShadedRays(inner.u, inner.transmittance, inner, vessel)
    if isinstance(vessel, GradedVial):
        return _bent(vessel)
    u = _offsets(vessel, reach, rays)
    chords = vessel.chords(u)
    if isinstance(vessel, (Vial, SquareBath)):
        entry, heading = trace_vial(vessel, u)
        cosine, sine = heading[:, 1], -heading[:, 0]
        p = entry[:, 0] * cosine + entry[:, 1] * sine
        start = np.sum(entry * heading, axis=1)
    else:
        p, cosine, sine = chords.p, np.cos(chords.angle), np.sin(chords.angle)
        start = np.where(np.isfinite(chords.length), -0.5 * chords.length, 0.0)
    return StraightRays(u, chords.transmittance, p, cosine, sine, start, vessel.absorption)


def trace_vial(vessel: Vial | SquareBath, u: Floats) -> tuple[Floats, Floats]:
    """Positions [mm] and unit headings (rays, 2) behind a vial's inner face of rays at u [mm], by Snell's law."""
    vial = vessel if isinstance(vessel, Vial) else vessel.vessel
    place = np.stack([u, np.full_like(u, -2.0 * vial.radius)], axis=1)
    heading = np.broadcast_to([0.0, 1.0], place.shape)
    if isinstance(vessel, SquareBath):
        normal = np.array([np.sin(vessel.tilt), -np.cos(vessel.tilt)])
        half, indices = 0.5 * vessel.width, (vessel.front_index, vessel.wall_index, vial.bath_index)
        for k, distance in enumerate((half + vessel.wall, half)):
            way = (distance - place @ normal) / (heading @ normal)
            place = place + way[:, None] * heading
            heading = refract(heading, np.broadcast_to(normal, heading.shape), indices[k], indices[k + 1])
    for face in vial.faces:
        back = np.sum(place * heading, axis=1)
        beside = place - back[:, None] * heading
        half = np.sqrt(np.maximum(face.radius**2 - np.sum(beside**2, axis=1), 0.0))
        place = beside - half[:, None] * heading
        heading = refract(heading, place / face.radius, face.outer_index, face.inner_index)
    return place, heading


def _offsets(vessel: Vessel, reach: float, rays: int) -> Floats:
    """Offsets [mm] of rays that reach the resin, closer together towards both ends, where refraction is steep."""
    coarse = np.linspace(-reach, reach, 4097)
    lit = np.flatnonzero(vessel.chords(coarse).transmittance > 0)
    if not lit.size:
        raise BadInput("no column of the beam reaches the resin; widen the beam or check the vessel's radius")
    low = _end(vessel, float(coarse[lit[0]]), float(coarse[max(lit[0] - 1, 0)]))
    high = _end(vessel, float(coarse[lit[-1]]), float(coarse[min(lit[-1] + 1, coarse.size - 1)]))
    return 0.5 * (low + high) + 0.5 * (high - low) * np.sin(np.linspace(-0.5, 0.5, rays) * np.pi)


def _end(vessel: Vessel, inner: float, outer: float) -> float:
    """The last offset that reaches the resin, between one that does and one that may not."""
    for _ in range(BISECTIONS if inner != outer else 0):
        middle = 0.5 * (inner + outer)
        lit = bool(vessel.chords(np.array([middle])).transmittance[0] > 0)
        inner, outer = (middle, outer) if lit else (inner, middle)
    return float(inner)


def _bent(vial: GradedVial) -> BentRays:
    """The marched rays of a vial whose resin bends them; the vial's own table is not inverted here."""
    sheet: Any = vial.sheet
    u = vial._column(np.arange(vial.rays, dtype=float))[0]
    return BentRays(u, vial.chords(u).transmittance, sheet.across, sheet.along, sheet.path, vial.absorption)
