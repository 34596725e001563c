"""Efficiency of UV, W = ∫([B]/[A]) d([A]/[A]₀), with light shaped by extinction and rotation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, inf

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.backend.device import Device
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.species import Floats, LightCycle, Rates, SpeciesState
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import Absorption, Background, Count, ExposureTime, Irradiance, Length

HALVINGS = 22
"""Number of halvings of the eleven decades of UV in which W is searched; the remaining error is 6e-6 of the value."""
LEAST = 1e-9  # ratio of UV to visible irradiance that counts as no UV


def exact_efficiency(alpha: float, beta: float = 0.0, stored: float = 0.0) -> float:
    """W under constant light without pairing (k₂ = 0): (2β + [B]₀/[A]₀)/(α − 2β), infinite where 2β ≥ α."""
    positive("alpha", alpha, zero=True)
    gain = 2.0 * positive("beta", beta, zero=True)
    made = gain + positive("stored", stored, zero=True)
    if made == 0.0:
        return 0.0
    return made / (alpha - gain) if gain < alpha else inf


@dataclass(frozen=True)
class RotatingLight:
    """Uniform light of two colors on a turning vial, absorbed by Beer-Lambert up to a point of the resin.

    Args:
        vial: Inner radius of the vial [mm].
        visible, uv: Irradiance at the wall [mW/mm²].
        visible_extinction, uv_extinction: Natural extinction of the fresh resin [1/mm].
        period: Time of a turn [s].
        poses: Number of intervals of constant light in a turn.

    Raises:
        BadInput: A number is negative or infinite, or vial, period or visible light is 0.
    """

    vial: Length = 15.0
    visible: Irradiance = 0.05
    uv: Background = 0.05
    visible_extinction: Absorption = 0.03
    uv_extinction: Absorption = 0.03
    period: ExposureTime = 9.0
    poses: Count = 72

    def __post_init__(self) -> None:
        check(self)

    def path(self, radius: ArrayLike, phase: ArrayLike = 0.0) -> Floats:
        """Path length through the resin, l = √(R² − r²) − x·cosθ − y·sinθ with r = y·cosθ − x·sinθ.

        Args:
            radius: Radius of the points [mm], (points,).
            phase: Their angle [rad], (points,).

        Returns:
            Length [mm], (points, poses).

        Raises:
            BadInput: A point is beyond the wall.
        """
        rho, start = np.broadcast_arrays(np.atleast_1d(np.asarray(radius, float)), np.asarray(phase, float))
        if not (np.isfinite(rho).all() and np.isfinite(start).all()) or rho.min() < 0 or rho.max() > self.vial:
            raise BadInput(f"points at radii {rho.min():g} … {rho.max():g} mm; expected 0 … {self.vial:g} mm, finite")
        turned = start[:, None] - 2.0 * np.pi * (np.arange(self.poses) + 0.5) / self.poses
        along, across = rho[:, None] * np.cos(turned), rho[:, None] * np.sin(turned)
        return np.sqrt(np.maximum(self.vial**2 - across**2, 0.0)) - along

    def at(self, radius: ArrayLike, phase: ArrayLike = 0.0) -> LightCycle:
        """Light of one turn at points.

        Args:
            radius: Radius of the points [mm], (points,).
            phase: Their angle [rad], (points,).

        Returns:
            The light, an interval for each angle.
        """
        way = self.path(radius, phase)
        seconds = np.full(self.poses, self.period / self.poses)
        visible = self.visible * np.exp(-self.visible_extinction * way)
        return LightCycle(visible, self.uv * np.exp(-self.uv_extinction * way), seconds)


def efficiency_at(
    rates: Rates | Sequence[Rates], light: RotatingLight, radius: ArrayLike, phase: ArrayLike = 0.0, *,
    most: float = 10.0, device: str | Device | None = None,
) -> Floats:  # fmt: skip
    """W of points at ``radius`` [mm], first lit at ``phase`` [rad], in fresh resin; (resins, points)."""
    resins = (rates,) if isinstance(rates, Rates) else tuple(rates)
    turn = light.at(radius, phase)
    turns = _turns(resins, light, turn, 1.0 + positive("most", most))
    return np.stack([_exposed(resin, turn, turns * light.poses, device)[0] for resin in resins])


def uv_needed(
    rates: Rates, light: RotatingLight, radius: ArrayLike, phase: ArrayLike = 0.0, *, target: float = 1.0,
    most: float = 100.0, device: str | Device | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """UV at the wall for an efficiency W: [mW/mm²] and [mJ/mm²], (points,). Raises `BadInput`."""
    turn = replace(light, uv=1.0).at(radius, phase)
    turns = _turns((rates,), light, turn, 1.5 * (1.0 + positive("target", target)))
    low = np.full(turn.sources, LEAST * light.visible)
    high = np.full(turn.sources, positive("most", most) * light.visible)

    def exposed(uv: Floats) -> tuple[Floats, Floats]:
        scaled = LightCycle(turn.visible, uv[:, None] * np.asarray(turn.uv), turn.seconds)
        return _exposed(rates, scaled, turns * light.poses, device)

    short = exposed(high)[0] < target
    if short.any():
        raise BadInput(f"{np.count_nonzero(short)} of {short.size} points do not reach W = {target:g} with "
                       f"{high[0]:g} mW/mm² of UV; raise most, the supply or the life of B")  # fmt: skip
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        enough = exposed(middle)[0] >= target
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    needed = np.sqrt(low * high)
    return needed, needed * exposed(needed)[1]


def _turns(resins: Sequence[Rates], light: RotatingLight, turn: LightCycle, factor: float) -> int:
    """Number of turns that last ``factor`` times the longest induction without UV."""
    mean = float(np.asarray(turn.visible).mean(axis=1).min())
    slow = min(resin.k_a / resin.oxygen for resin in resins)
    if slow == 0:
        raise BadInput("k_a is 0; expected k_a > 0, because otherwise oxygen is never used up")
    return ceil(factor / (slow * mean * light.period)) + 1


def _exposed(rates: Rates, turn: LightCycle, intervals: int, device: str | Device | None) -> tuple[Floats, Floats]:
    """W (infinite if not depleted) and the time until depletion [s], (points,)."""
    start = SpeciesState(np.full(turn.sources, rates.oxygen), 0.0, rates.supply)
    trajectory = advance(rates, start, turn, intervals=intervals, device=device)
    done = trajectory.depleted[0]
    time = np.where(done, trajectory.event[0], intervals * float(np.asarray(turn.seconds)[0]))
    return np.where(done, trajectory.efficiency[0], inf), time
