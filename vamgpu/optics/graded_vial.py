"""A vial whose resin has an index that varies: exact refraction at its faces, bent rays between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput, RayError
from vamgpu.geometry import Chords, Vessel
from vamgpu.optics.index_field import FormulaField, FunctionField, GridField, Region
from vamgpu.optics.inputs import Floats, absorbed_share, as_offsets
from vamgpu.optics.interface import Crossing, Polarization, impact_after, polarized, transmittance
from vamgpu.optics.march import march
from vamgpu.optics.ray_sheet import RaySheet, through
from vamgpu.optics.vial import LARGEST_DENSITY
from vamgpu.schema import check
from vamgpu.schema.quantities import Absorption, Index, Quantity, Thickness, VesselRadius

SETTLED = 1e-9  # accuracy of the ends of rays, relative to the radius
TANGENT = 1e-4  # cosine of refraction below which the end of a ray is too sensitive for this accuracy


@dataclass(frozen=True)
class GradedVial(Vessel):
    """A round vial of resin of index n(X, Y). The index does not rotate with the resin, or is symmetric about z.

    Frame and columns are those of `Vial`: X counts the beam's columns, light comes along +Y. Fresnel loss and Snell's
    law at both faces use the index where a ray meets them; between the faces d²R/dt² = ½∇n² is integrated. Parts that
    turn with the resin must not have an index of their own, unless it is the same all around. Chords are the straight
    lines nearest to the bent rays, with the length of the bent rays; weights count columns per mm across the bent ray.

    Args:
        radius: Outer radius [mm].
        wall: Thickness of the wall [mm]; 0 for no wall, then wall_index has no effect.
        resin: n² over the whole resin; the field's own region has no effect.
        wall_index: Refractive index of the wall.
        bath_index: Refractive index around the vial.
        absorption: Absorption of the resin, natural logarithm [1/mm].
        rays: Number of traced rays; values between them are interpolated by cubic splines.
        rows: Number of points stored along each ray.
        polarization: Polarization of the light, as for `Vial`.

    Raises:
        BadInput: A value is out of its range.
        RayError: A ray never leaves the resin or turns back; raised when the light is first computed.
    """

    radius: VesselRadius
    wall: Thickness
    resin: FormulaField | GridField | FunctionField
    wall_index: Index
    bath_index: Index = 1.0
    absorption: Absorption = 0.0  # pyright: ignore[reportIncompatibleMethodOverride] - a field
    rays: Annotated[int, Quantity(least=33, whole=True)] = 513
    rows: Annotated[int, Quantity(least=17, whole=True)] = 257
    polarization: Polarization = "none"

    def __post_init__(self) -> None:
        check(self)
        polarized("GradedVial polarization", self.polarization)
        if self.wall >= self.radius:
            raise BadInput(f"wall is {self.wall:g} mm in a vial of outer radius {self.radius:g} mm; expected less")
        if not isinstance(self.resin, (FormulaField, GridField, FunctionField)):
            raise BadInput(f"resin is {self.resin!r}; expected a FormulaField, a GridField or a FunctionField")
        reach = 0.5 * (min(self.resin.coefficients.shape[:2]) - 3) * self.resin.pitch \
            if isinstance(self.resin, GridField) else self.inner_radius  # fmt: skip
        if reach < self.inner_radius * (1.0 - 1e-9):
            raise BadInput(f"the grid of the index reaches {reach:g} mm from its middle; expected at least the inner "
                           f"radius of the vial, {self.inner_radius:g} mm")  # fmt: skip

    @property
    def inner_radius(self) -> float:
        """Radius of the resin [mm]."""
        return self.radius - self.wall

    def _entry(self, u: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Position on the inner face (rays, 2), turn of the ray before it [rad], index behind it, sine before it."""
        turn, sine = np.zeros_like(u), u / self.radius
        before = u.copy()
        if self.wall > 0:
            before = impact_after(u, self.bath_index, self.wall_index)
            turn = np.arcsin(_sine(sine)) - np.arcsin(_sine(before / self.radius))
            sine = before / self.inner_radius
        back = -np.sqrt(np.maximum((self.inner_radius - before) * (self.inner_radius + before), 0.0))
        c, s = np.cos(turn), np.sin(turn)
        place = np.stack([before * c - back * s, before * s + back * c], axis=-1)
        _, square = self.resin.evaluate(np.pad(place.reshape(-1, 2), ((0, 0), (0, 1))))
        if (square <= 0).any():
            raise RayError(f"n² is {square.min():g} at the inner face; expected a resin of an index above 0")
        return place, turn, np.sqrt(square).reshape(u.shape), sine

    @property
    def _outer_index(self) -> float:
        """In front of the inner face."""
        return self.wall_index if self.wall > 0 else self.bath_index

    @cached_property
    def _span(self) -> tuple[float, float]:
        """The first and last column [mm] whose rays enter the resin."""
        most = self.radius
        if self.wall > 0:
            most = min(most, *(r * self.wall_index / self.bath_index for r in (self.radius, self.inner_radius)))

        def enters(u: Floats) -> Any:
            return np.abs(u) * self.bath_index <= self._entry(u)[2] * self.inner_radius

        ends = []
        for side in (-1.0, 1.0):
            u = side * most * np.sin(np.linspace(0.0, 0.5 * np.pi, 2049))
            refused = np.flatnonzero(~enters(u))
            low, high = (u[refused[0] - 1], u[refused[0]]) if refused.size else (u[-1], u[-1])
            for _ in range(60):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if enters(np.array([middle]))[0] else (low, middle)
            ends.append(float(low))
        return ends[0], ends[1]

    def _share(self, u: Floats) -> Floats:
        """Power that crosses both faces."""
        _, _, behind, sine = self._entry(u)
        front = self._outer_index
        crossings: list[Crossing] = [(_cosine(sine), _cosine(sine * front / behind), front, behind)]
        if self.wall > 0:
            cos_in, cos_out = _cosine(u / self.radius), _cosine(impact_after(u, self.bath_index, front) / self.radius)
            crossings.append((cos_in, cos_out, self.bath_index, front))
        return transmittance(crossings, self.polarization)

    def _node(self, u: Floats) -> Floats:
        """Fractional index of the ray of a column: nodes are evenly spaced in ψ, with u = middle + half·sin ψ."""
        low, high = self._span
        return (np.arcsin(_sine((2.0 * u - low - high) / (high - low))) / np.pi + 0.5) * (self.rays - 1)

    def _column(self, node: Floats) -> tuple[Floats, Floats]:
        """Column [mm] of a fractional index and its slope."""
        (low, high), psi = self._span, (node / (self.rays - 1) - 0.5) * np.pi
        half = 0.5 * (high - low)
        return 0.5 * (low + high) + half * np.sin(psi), half * np.cos(psi) * np.pi / (self.rays - 1)

    @cached_property
    def sheet(self) -> RaySheet:
        """The rays from face to face."""
        u, _ = self._column(np.arange(self.rays, dtype=float))
        place, turn, behind, sine = self._entry(u)
        turn = turn + np.arcsin(_sine(sine)) - np.arcsin(_sine(sine * self._outer_index / behind))
        along = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
        field = replace(self.resin, region=Region.cylinder(self.inner_radius))
        times = np.zeros(self.rays)
        clear = _cosine(sine * self._outer_index / behind) > TANGENT
        times[clear] = march(field, place[clear], along[clear], tolerance=SETTLED * self.radius, device="numpy").time
        if not clear.all():  # a tangent ray either leaves at once or is drawn inwards
            step = self.radius / 256
            times[~clear] = march(field, place[~clear], along[~clear], step=step, device="numpy").time
            times[~clear & (times < 2.0 * step)] = 0.0
        zero = np.zeros((self.rays, 1))
        starts = np.concatenate([place, zero, along * behind[:, None], zero], axis=1)
        return RaySheet.traced(field.evaluate, starts, times, self.rows)

    @cached_property
    def _chords(self) -> tuple[Floats, Floats, Floats]:
        """Distance p and turn d of the straight chord nearest each ray, and the ray's length."""
        x, y = self.sheet.across, self.sheet.along
        # The chord of a ray without length is the tangent of the nearest neighbor that has one.
        angle = np.arctan2(-(x[:, -1] - x[:, 0]), y[:, -1] - y[:, 0])
        short = self.sheet.path[:, -1] < 1e-6 * self.radius
        if short.any():
            node = np.arange(self.rays)
            angle[short] = np.interp(node[short], node[~short], angle[~short])
        offset = x * np.cos(angle)[:, None] + y * np.sin(angle)[:, None]
        return 0.5 * (offset.min(axis=1) + offset.max(axis=1)), angle, self.sheet.path[:, -1]

    @cached_property
    def lit_radius(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Radius [mm] within which, at every angle, every point has a ray and no two rays meet."""
        distance = np.hypot(self.sheet.across, self.sheet.along)
        crossed = distance[2:-2][self.sheet.turned[2:-2] <= 0.0]
        outermost = (_least(self.sheet.across[ray], self.sheet.along[ray]) for ray in (0, -1))
        return float(min(self.inner_radius, *outermost, crossed.min(initial=np.inf)))

    def chords(self, u: ArrayLike) -> Chords:
        offsets = as_offsets("u", u)
        low, high = self._span
        kept, reaches = np.clip(offsets, low, high), (offsets > low) & (offsets < high)
        node = self._node(kept)
        (p, _), (angle, turning), (length, _) = (through(values, node) for values in self._chords)
        _, slope = self._column(node)
        return Chords(p=p, angle=angle, spread=turning / np.maximum(slope, 1e-9 * (high - low)),
                      transmittance=np.where(reaches, self._share(kept), 0.0),
                      length=np.where(reaches, np.maximum(length, 0.0), 0.0))  # fmt: skip

    def illuminate(self, across: ArrayLike, along: ArrayLike) -> tuple[Floats, Floats]:
        points_x, points_y = np.broadcast_arrays(as_offsets("across", across), as_offsets("along", along))
        inside = points_x**2 + points_y**2 < self.inner_radius**2
        low, high = self._span
        u, weight = np.where(points_x < 0, low, high), np.zeros(inside.shape)
        if inside.any():
            u[inside], weight[inside] = self._inside(points_x[inside], points_y[inside])
        return u, weight

    def _inside(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        low, high = self._span
        ray, share, met = self.sheet.find(x, y, float(self._node(np.zeros(1))[0]))
        u, slope = self._column(ray)
        across, along, path = self.sheet.at(ray, share)
        crossing = across[1] * along[2] - across[2] * along[1]
        width = np.hypot(across[2], along[2]) * np.maximum(slope, 1e-9 * (high - low))
        density = width / np.maximum(np.abs(crossing), width * self.bath_index / LARGEST_DENSITY)
        weight = self._share(u) * density * absorbed_share(self.absorption, np.maximum(path[0], 0.0))
        return np.where(met, u, np.where(x < 0, low, high)), np.where(met, weight, 0.0)


def _sine(value: Floats) -> Floats:
    return np.clip(value, -1.0, 1.0)


def _cosine(sine: Floats) -> Floats:
    return np.sqrt(np.maximum((1.0 - sine) * (1.0 + sine), 0.0))


def _least(x: Floats, y: Floats) -> float:
    """Smallest distance of a smooth path from the origin, from the parabola through the three nearest points."""
    square = x**2 + y**2
    i = int(np.clip(np.argmin(square), 1, square.size - 2))
    a, b, c = square[i - 1 : i + 2]
    bend = a - 2.0 * b + c
    low = b - (c - a) ** 2 / (8.0 * bend) if bend > 0 and abs(c - a) <= 2.0 * bend else min(a, b, c)
    return float(np.sqrt(max(low, 0.0)))
