"""A beam through a cuvette of resin that scatters: what a power meter, a sphere and a sheet of paper receive."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import exp, expm1, tan
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN
from vamgpu.kernels.photons import WAYS, free_path, philox, scattered, unit
from vamgpu.optics.inputs import Floats
from vamgpu.optics.interface import transmittance
from vamgpu.optics.scattering import Scattering
from vamgpu.schema import check
from vamgpu.schema.quantities import Deviation, HalfAngle, Index, Length, NonNegative, Thickness

QUANTILES = 1 << 12
MOST = 4000  # greatest number of segments of a photon; one that is still in the resin then is given up
ANGLES = 1 << 12  # cosines from 0 to 1 at which the transmittance of a face is computed


@dataclass(frozen=True)
class Cuvette:
    """A cuvette in a narrow beam, and what measures the light behind it.

    Light meets the near face at a right angle, in the middle. Light that reaches the sides is lost.

    Args:
        width: Inner width across the beam [mm].
        wall: Thickness of the walls [mm].
        resin_index: Refractive index of the resin.
        wall_index: Refractive index of the walls.
        beam: Diameter of the beam [mm].
        screen: Distance from the far face to the paper [mm].
        pixel: Width on the paper of a pixel of the images [mm].
        hole: Diameter of the hole in the paper [mm].
        dark: Gray level of images without light.
        acceptance: Half the angle that the meter of collimated light collects [rad].
        port: Diameter of the sphere's opening at the far face [mm]; None if it collects all light of that face.
        bath_index: Refractive index around the cuvette.
        full: Gray level of a saturated pixel; None for the greatest of the image's type.
        error: Relative error (σ) of the readings of light.

    Raises:
        BadInput: A value is out of its range.
    """

    width: Length
    wall: Thickness
    resin_index: Index
    wall_index: Index
    beam: Length
    screen: Length
    pixel: Length
    hole: Length
    dark: NonNegative
    acceptance: HalfAngle = 0.01
    port: Length | None = None
    bath_index: Index = 1.0
    full: NonNegative | None = None
    error: Deviation = 0.01

    def __post_init__(self) -> None:
        check(self)
        if self.full is not None and self.full <= self.dark:
            raise BadInput(f"Cuvette full is {self.full:g}; expected more than dark, which is {self.dark:g}")
        if self.beam >= min(self.width, self.hole):
            raise BadInput(f"Cuvette beam is {self.beam:g} mm wide; expected less than the cuvette of {self.width:g} "
                           f"mm and the hole of {self.hole:g} mm, through which it leaves")  # fmt: skip

    @cached_property
    def passing(self) -> tuple[Floats, Floats]:
        """Cosines of light in the resin, and its transmittance through a wall."""
        cosine = np.linspace(0.0, 1.0, ANGLES + 1)
        sine, indices = np.sqrt(1.0 - cosine**2), (self.resin_index, self.wall_index, self.bath_index)
        inside = [np.maximum(1.0 - (sine * self.resin_index / index) ** 2, 0.0) ** 0.5 for index in indices]
        return cosine, transmittance(zip(inside[:-1], inside[1:], indices[:-1], indices[1:], strict=True))

    @property
    def clear(self) -> float:
        """Share of the beam that passes one face."""
        return float(self.passing[1][-1])


def detected(
    cuvette: Cuvette, thickness: float, resin: Scattering, absorption: float, edges: Floats, photons: int, seed: int
) -> tuple[Floats, Floats, Floats, float]:  # fmt: skip
    """Collimated light, total light, and light on rings between edges [mm] of the paper, for a beam of 1.

    Returns them, (2 + rings,), their derivatives by μ_s, g and absorption, (3, 2 + rings), their variance by the number
    of photons, and the light of photons that were given up. Derivatives come from the same photons: the probability of
    a path of length ℓ with n collisions is proportional to μ_s^n · exp(−(μ_s + absorption)·ℓ) times the phase function
    at each of them.
    """
    rate, reflected = resin.coefficient, 1.0 - cuvette.clear
    once = exp(-(rate + absorption) * thickness)
    again = (reflected * once) ** 2
    beam = cuvette.clear**2 * once / (1.0 - again)  # light that is not scattered
    first = -expm1(-rate * thickness) * (1.0 + reflected * exp(-rate * thickness)) * cuvette.clear / photons
    (number, chance, path, score, away, wide, sine), left = _followed(cuvette, thickness, resin, photons, seed)
    weight = first * chance * np.exp(-absorption * path)
    seen = (sine < np.sin(cuvette.acceptance), away < 0.5 * (cuvette.port or np.inf))
    ring = np.digitize(wide, edges) - 1
    ring[ring == edges.size - 1] = -1

    def summed(share: Floats) -> Floats:
        rings = np.bincount(ring[ring >= 0], share[ring >= 0], edges.size - 1)
        return np.concatenate([[share[each].sum() for each in seen], rings])

    parts = (*seen, *(ring == k for k in range(edges.size - 1)))
    own = [np.bincount(number[each], weight[each], photons) for each in parts]  # ways of a photon depend on each other
    value, variance = np.sum(own, axis=1), photons * np.var(own, axis=1) + first**2
    slope = np.array([summed(weight * each) for each in (*score, -path)])
    value[:2] += beam
    slope[::2, :2] -= thickness * beam * (1.0 + again) / (1.0 - again)
    return value, slope, variance, first * float(np.exp(-absorption * left).sum())


def _followed(
    cuvette: Cuvette, thickness: float, resin: Scattering, photons: int, seed: int
) -> tuple[tuple[np.ndarray, Floats, Floats, Floats, Floats, Floats, Floats], Floats]:  # fmt: skip
    """Ways of photons out of the far face, all scattered at least once; and paths [mm] of those given up."""
    # Returns of each: photon; probability; path [mm]; derivatives of its logarithm by μ_s and g, (2, ways);
    # distance from the beam at the outer face and on the paper [mm]; sine of the angle behind the cuvette.
    rate, number, ends = resin.coefficient, np.arange(photons), []
    turn, bits = FULL_TURN * np.arange(WAYS) / WAYS, philox(np.arange(photons), 0, seed)
    cosines = resin.cosines(QUANTILES).astype(np.float32)
    ways = np.stack([np.cos(turn), np.sin(turn)], axis=1).astype(np.float32)
    back = (1.0 - cuvette.clear) * exp(-rate * thickness)
    returns = unit(bits[0]) * (1.0 + back) < back  # from the far face
    radius, angle = 0.5 * cuvette.beam * np.sqrt(unit(bits[1])), FULL_TURN * unit(bits[2])
    p, u = np.zeros((2, 3, photons))
    p[0], p[1], p[2] = radius * np.cos(angle), radius * np.sin(angle), thickness * returns
    u[2] = 1.0 - 2.0 * returns
    path, count, bend = thickness * returns, np.zeros(photons), np.zeros(photons)
    free = -np.log1p(expm1(-rate * thickness) * (number + 0.5) / photons) / rate  # all collide
    for segment in range(1, MOST):
        with np.errstate(divide="ignore", invalid="ignore"):
            to_side = (0.5 * cuvette.width - np.sign(u[0]) * p[0]) / np.abs(u[0])
            to_face = np.where(u[2] > 0, thickness - p[2], p[2]) / np.abs(u[2])
        passing, bits = np.interp(np.abs(u[2]), *cuvette.passing), philox(number, segment, seed)
        if segment > 1:  # by the probability that they leave, whether they do or not
            out = (u[2] > 0) & (to_face < to_side) & (passing > 0)
            at, way, gone, *others, rest = (each[..., out] for each in (p, u, path, number, count, bend, to_face))
            ends.append((at + way * rest, way, gone + rest, *others, passing[out] * np.exp(-rate * rest)))
        step = np.fmin(np.fmin(free, to_side), to_face)
        p, path, collides, on_side = p + u * step, path + step, step == free, to_side < to_face
        live = collides | (~on_side & (unit(bits[1]) >= passing))
        turned, bent = _turned(u, bits[2], bits[3], cosines, ways, float(resin.anisotropy))
        in_wall = ~collides & (np.hypot(u[0], u[1]) * cuvette.resin_index < cuvette.wall_index)  # or back before it
        p[:2] += np.where(in_wall, 2.0 * cuvette.wall * u[:2] / _cosine(u, cuvette, cuvette.wall_index), 0.0)
        u = np.where(collides, turned, u * [[1.0], [1.0], [-1.0]])
        bend, count = bend + np.where(collides, bent, 0.0), count + collides
        number, p, u, path, count, bend = (each[..., live] for each in (number, p, u, path, count, bend))
        if not number.size:
            break
        free = free_path(unit(bits[0][live])).astype(np.float64) / rate
    left: Any = path
    p, u, path, number, count, bend, chance = (np.concatenate(each, axis=-1) for each in zip(*ends, strict=True))
    at_face = p[:2] + cuvette.wall * u[:2] / _cosine(u, cuvette, cuvette.wall_index)
    on_paper = at_face + cuvette.screen * u[:2] / _cosine(u, cuvette, cuvette.bath_index)
    sine = cuvette.resin_index / cuvette.bath_index * np.hypot(u[0], u[1])
    score = np.stack([count / rate - path, bend])
    return (number, chance, path, score, np.hypot(*at_face), np.hypot(*on_paper), sine), left


def _cosine(u: np.ndarray, cuvette: Cuvette, index: float) -> Floats:
    """Ratio of the cosine of the angle to the faces, in a medium, to that of the index of the resin to its own."""
    return np.sqrt(np.maximum((index / cuvette.resin_index) ** 2 - u[0] ** 2 - u[1] ** 2, 1e-9))


def _turned(
    u: np.ndarray, bits: np.ndarray, way: np.ndarray, cosines: np.ndarray, ways: np.ndarray, g: float
) -> tuple[Floats, Floats]:  # fmt: skip
    """Directions after a collision, and the derivative by g of the logarithm of their probability."""
    turned = scattered(u.astype(np.float32), bits, way >> np.uint32(22), cosines, ways).astype(np.float64)
    turned /= np.sqrt((turned**2).sum(axis=0))
    cosine = (u * turned).sum(axis=0)
    return turned, 3.0 * (cosine - g) / (1.0 + g * g - 2.0 * g * cosine) - 2.0 * g / (1.0 - g * g)


def ring_edges(cuvette: Cuvette, reach: float, rings: int) -> Floats:
    """Radii [mm] of rings on the paper, from its hole to ``reach``, at even angles."""
    low, high = (np.arctan(radius / cuvette.screen) for radius in (0.5 * cuvette.hole + cuvette.pixel, reach))
    return cuvette.screen * np.array([tan(angle) for angle in np.linspace(low, high, rings + 1)])
