"""Photoinhibition of many items at once: voxels, resins, or both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.chemistry.species import Floats, LightCycle, Rates, SpeciesState
from vamgpu.errors import BadInput
from vamgpu.geometry import counts, positive
from vamgpu.kernels.kinetics import MOST, UNSETTLED, inhibit

TOLERANCE = 1e-6
"""Error of a step, relative to [A] before printing, above which steps are shortened; float32 is no more accurate."""


@dataclass(frozen=True, eq=False)
class KineticTrajectory:
    """Final states of items, arrays (resins, items), concentrations in the unit of the rates."""

    a: Floats  # concentrations; from the event on a and b are 0, and c does not change
    b: Floats
    c: Floats
    dose: Floats  # of visible light until the end or the event [mJ/mm²]
    event: Floats  # when [A] + [B] reached 1e-6 of [A] before printing; NaN if it did not [s]
    efficiency: Floats  # W = ∫([B]/[A]) d([A]/[A]₀) so far
    path: Floats  # [A], [B], [C] and dose at the start and after every ``every`` intervals, (resins, items, rows, 4)

    @property
    def depleted(self) -> np.ndarray:
        """Whether polymerization has begun, (resins, items)."""
        return np.isfinite(self.event)


def advance(
    rates: Rates | Sequence[Rates], state: SpeciesState, light: LightCycle, *, intervals: int | None = None,
    first: int = 0, rows: int = 1, tolerance: float = TOLERANCE, device: str | Device | None = None,
) -> KineticTrajectory:  # fmt: skip
    """Expose every item in every resin to the light (eqs 5–7, with a non-negative continuation at the origin).

    Rosenbrock steps of third order, as long as each item allows. [B] + 2[C] + α[A] falls by k_B times the dose, up to
    rounding and 1e-6 of ``oxygen``. [A] + [B] = 1e-6·oxygen is the event: polymerization begins, and A and B stay 0.

    Args:
        rates: one resin or several.
        state: items at the start, the same for every resin.
        light: one source for all items, or one for each item.
        intervals: number of intervals from ``first`` on, cyclically; None for each once.
        rows: number of states in the stored path, equally many intervals apart; the first is the start.
        tolerance: of a step, in ``oxygen``.

    Raises:
        BadInput: values that cannot be used, or an item that needs more than 20,000 steps in one interval.
    """
    resins = (rates,) if isinstance(rates, Rates) else tuple(rates) if isinstance(rates, Sequence) else ()
    if not resins or not all(isinstance(resin, Rates) for resin in resins):
        raise BadInput(f"rates are {rates!r}; expected Rates, or several")
    if not isinstance(state, SpeciesState) or not isinstance(light, LightCycle):
        raise BadInput(
            f"got {type(state).__name__} and {type(light).__name__}; expected a SpeciesState and a LightCycle"
        )
    if not isinstance(first, (int, np.integer)):
        raise BadInput(f"first is {first!r}; expected the number of an interval")
    if light.sources not in (1, len(state)):
        raise BadInput(f"{light.sources} sources of light for {len(state)} items; expected 1 or {len(state)}")
    (count,) = counts("intervals", (light.intervals if intervals is None else intervals,), 1)
    (rows,) = counts("rows", (rows,), 1)
    every = -(-count // (rows - 1)) if rows > 1 else count
    where, items = open_device(device), len(resins) * len(state)
    before = np.zeros((items, 4))
    before[:, :3] = np.tile(state.table, (len(resins), 1))
    real, seconds, start = where.real, np.asarray(light.seconds), int(first) % light.intervals
    after, path, times = (where.empty(shape, real, table=True) for shape in ((items, 4), (items, rows, 4), (items,)))
    where.launch(
        inhibit, before=where.table(before), rates=where.table(np.array([resin.row for resin in resins])),
        light=where.table(light.table), lengths=where.table(seconds), first=start, count=count, every=every,
        tolerance=positive("tolerance", tolerance), after=after, path=path, times=times,
    )  # fmt: skip
    shape = (len(resins), len(state))
    ends, when = after.numpy().astype(np.float64), times.numpy().astype(np.float64)
    if (when == UNSETTLED).any():
        stuck = np.count_nonzero(when == UNSETTLED)
        raise BadInput(f"{stuck} of {items} items do not converge within {MOST} steps of one interval at a tolerance "
                       f"of {tolerance:g}; use a larger tolerance, or make intervals shorter")  # fmt: skip
    # W from the balance of visible light, which equals the integral by eq. 5; NaN without oxygen at the start
    oxygen, used = before[:, 0], np.repeat([resin.k_a for resin in resins], len(state)) * ends[:, 3]
    efficiency = (used - (oxygen - ends[:, 0])) / np.where(oxygen > 0, oxygen, np.nan)
    event = np.where(when < 0, np.nan, when)
    a, b, c, dose, event, efficiency = (v.reshape(shape) for v in (*ends.T, event, efficiency))
    return KineticTrajectory(a, b, c, dose, event, efficiency, path.numpy().astype(np.float64).reshape(*shape, rows, 4))
