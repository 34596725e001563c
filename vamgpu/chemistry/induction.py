"""The four induction times of the photoinhibition paper, and rate constants that fit them, for [A] = 1 before printing
and an irradiance of 1 of each lamp.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.species import Floats, LightCycle, Rates, SpeciesState
from vamgpu.errors import BadInput
from vamgpu.geometry import positive

MEASURED = (30.0, 38.0, 50.0, 68.0)
"""Induction [s]: without UV; with UV before visible light; with UV after visible light without oxygen; with both.

"Binary photoinhibition", Discussion: the only kinetic data of the paper.
"""
NAMES = ("no UV", "UV before", "UV after oxygen is gone", "UV together with visible")
UV_SECONDS = 30.0
LONGEST = 400.0  # longest simulated time of the trials [s]
TRACE = 2e-6  # [A] that stands for 0: just above the depletion threshold; UV can then still fill the resin with B
GRID = {"alpha": (0.01, 10.0, 25), "k_c": (1e-3, 150.0, 31), "k_2": (1e-4, 10.0, 21)}
"""Lowest and highest value, and number of values, of the first search, in equal ratios."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Rate constants fitted to induction times."""

    rates: Rates  # normalized
    times: tuple[float, ...]  # [s], in the order of `NAMES`
    measured: tuple[float, ...]  # [s], in the order of `NAMES`
    bound: tuple[str, ...] = ()  # names of constants at the end of their range, which the data do not determine

    @property
    def errors(self) -> tuple[float, ...]:
        """Fitted minus measured [s]."""
        return tuple(t - m for t, m in zip(self.times, self.measured, strict=True))

    @property
    def rms(self) -> float:
        """Root mean square error of the trials with UV [s]; k_A fits the trial without UV exactly."""
        return float(np.sqrt(np.mean(np.square(self.errors[1:]))))


def induction_times(rates: list[Rates], device: str | Device | None = None) -> Floats:
    """Time under visible light until both inhibitors are gone in the four trials [s], at most 400 s; (resins, 4)."""
    if any(resin.oxygen != 1.0 for resin in rates):
        raise BadInput(f"oxygen is {[r.oxygen for r in rates if r.oxygen != 1.0][0]:g}; expected rates normalized to 1")
    supply = max(resin.supply for resin in rates)
    if any(resin.supply != supply for resin in rates):
        raise BadInput("the resins have different supplies; expected one supply, or a call for each")
    start = SpeciesState([1.0, 1.0, TRACE, 1.0], 0.0, supply)
    visible = [[0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [1.0, 1.0]]
    uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 0.0]]
    trajectory = advance(rates, start, LightCycle(visible, uv, [UV_SECONDS, LONGEST]), device=device)
    dose = np.where(trajectory.depleted, trajectory.dose, LONGEST)
    without = np.array([1.0 / resin.k_a for resin in rates])
    dose[:, 2] += without
    return dose


def fit_induction(
    measured: tuple[float, float, float, float] = MEASURED, *, supply: float = 200.0, order: int = 0,
    device: str | Device | None = None,
) -> Fit:  # fmt: skip
    """Fit α, k_C and k₂ to induction times; k_A is 1 over the first time.

    A grid of resins in one launch, then least squares from its best entries. Three constants are fitted to three times;
    remaining errors are due to the equations.

    Args:
        measured: Induction times [s] in the order of `NAMES`.
        supply: Ratio [C] / [A] before printing; a supply of 200 is never exhausted.
        order: Order of the reaction in [C], 0 or 1.
        device: A name or a device; the best available device by default.

    Returns:
        The constants and the times that they give.

    Raises:
        BadInput: A time is not positive, or a UV trial is shorter than the one without.
    """
    from scipy.optimize import least_squares

    seconds = tuple(positive("measured [s]", value) for value in measured)
    if len(seconds) != len(NAMES) or min(seconds) < seconds[0]:
        raise BadInput(f"measured is {measured}; expected {len(NAMES)} times, the first (without UV) the shortest")

    def resin(logs: Floats) -> Rates:
        alpha, k_c, k_2 = np.exp(logs)
        return Rates(1.0 / seconds[0], alpha / seconds[0], k_c, k_2, supply=supply, order=order)

    def errors(points: Floats) -> Floats:
        return (induction_times([resin(p) for p in points], device) - np.array(seconds))[:, 1:]

    axes = [np.log(np.geomspace(*span)) for span in GRID.values()]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    cost = np.square(np.clip(errors(grid), -200.0, 200.0)).sum(axis=1)
    low, high = np.array([axis[0] for axis in axes]), np.array([axis[-1] for axis in axes])

    def slopes(logs: Floats) -> Floats:
        step = 2e-3 * np.concatenate([np.eye(3), -np.eye(3)])
        values = errors(np.clip(logs + step, low - 1.0, high + 1.0))
        return (values[:3] - values[3:]).T / 4e-3

    best, least = grid[np.argmin(cost)], np.inf
    jac: Any = slopes  # the stubs type jac only as a string
    for start in grid[np.argsort(cost)[:6]]:
        inside = np.clip(start, low + 1e-3, high - 1e-3)
        found = least_squares(lambda p: errors(p[None])[0], inside, jac, bounds=(low, high), max_nfev=60)
        if found.cost < least:
            best, least = found.x, found.cost
    at_end = np.minimum(best - low, high - best) < 0.02
    names = tuple(name for name, end in zip(GRID, at_end, strict=True) if end)
    chosen = resin(best)
    return Fit(chosen, tuple(float(t) for t in induction_times([chosen], device)[0]), seconds, names)
