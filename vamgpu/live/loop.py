"""Measure, estimate, replan, swap: the decision after every turn, a pure function of the images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import repeat
from math import exp, floor, inf
from time import perf_counter
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import VamError
from vamgpu.kernels.watch import conversion_deviation
from vamgpu.live.estimate import Estimate, Estimator
from vamgpu.live.fields import added, alike, here, picked, places, scaled
from vamgpu.live.printer import CuringResin
from vamgpu.live.prior import Prior
from vamgpu.live.replan import Replanned, Replanner
from vamgpu.live.smoothing import Smoothing
from vamgpu.live.tomography import TINY, OpticalDepths, Reconstruction, Tomograph
from vamgpu.live.trust import Trust, darkening, digest, mean_level, share_of, some, sunk
from vamgpu.metrics.histogram import above
from vamgpu.metrics.parts import IN, Parts
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import total
from vamgpu.quantity import counted

SIGNIFICANT = 0.1
"""Smallest conversion that counts as seen."""
ENOUGH = 50
"""Smallest number of such voxels for an estimate."""
MODEL = 0.1
"""Error of the conversion from resin and tomograph, in addition to the noise."""
COMMON = 0.05
"""Relative error of the conversion seen that all voxels have alike."""
FIRST = 1000
"""Greatest number of voxels of the first estimate."""
USUAL = {"absorption": 0.1, "across": 0.05, "height": 0.05, "initial_dose": 0.2, "sensitivity": 0.2}
"""Deviations of parameters that a blurred field hardly distinguishes, and of the inhibitor that a vial's age consumed;
[mm] or dimensionless."""
GAINS = np.geomspace(0.5, 2.0, 41)
INHIBITORS = np.linspace(0.4, 1.1, 36)
"""Values of light and inhibitor, relative to the plan, to try before the other parameters are estimated."""
ROUNDING = 1e-3
"""Tolerance, in turns, of sums of light."""
ONSET = 0.02
"""Share of the planned print's darkening below which nothing counts as cured."""
KEPT = 4
"""Number of lights whose copies on the device are kept."""


@dataclass(frozen=True, eq=False)
class Decision:
    """The decision after a turn.

    Args:
        turn: Turns shown so far.
        action: "keep" the light, "swap" it at the boundary, or "stop".
        version: Version of the light that continues.
        light: Light of the next turn, [angle, r, z].
        turns: Expected number of remaining turns.
        inhibitor: Estimated inhibitor, relative to fresh resin, dimensionless.
        parameters: Estimated values and deviations by name, dimensionless or [mm]; empty if nothing is estimated.
        iou: Lowest overlap expected at the end, within the errors of gel point and dose, dimensionless.
        reason: Reason in words.
        doubt: Reason why images no longer decide; empty if they do. The planned light then continues until images are
            as dark as the planned print makes them, with at most the dose of the plan, and no overlap is predicted.
        misfit: Misfit of the images, dimensionless, see `Reconstruction.misfit`; 0 without images.
        checks: Values and limits, dimensionless, of what was checked: ``images``, their misfit, and ``conversion``, the
            share that the light shown does not explain.
        stages: Wall time of "see", "estimate" and "replan" [s]; not in `entry`, because a replay takes another time.
        dose: Estimated dose of all light so far, relative to that of solid resin, [x, y, z] on the device
            (``.numpy()`` copies it); not in `entry`. None if nothing is estimated.
        conversion: Reconstructed conversion, [x, y, z] on the device; not in `entry`. None before the first field.
    """

    turn: int
    action: str
    version: int
    light: np.ndarray
    turns: int
    inhibitor: float = 1.0
    parameters: dict[str, tuple[float, float]] = field(default_factory=dict)
    iou: float = 0.0
    reason: str = ""
    doubt: str = ""
    misfit: float = 0.0
    checks: dict[str, tuple[float, float]] = field(default_factory=dict)
    stages: dict[str, float] = field(default_factory=dict)
    dose: DeviceArray | None = None
    conversion: DeviceArray | None = None

    @property
    def entry(self) -> dict[str, Any]:
        """Entry of the run's record: every number, and the digest of the light."""
        return {
            "turn": self.turn, "action": self.action, "version": self.version, "turns": self.turns,
            "inhibitor": self.inhibitor, "parameters": {name: list(v) for name, v in self.parameters.items()},
            "iou": self.iou, "reason": self.reason,
            "light": digest(np.asarray(self.light, np.float32)), "doubt": self.doubt, "misfit": self.misfit,
            "checks": {name: list(pair) for name, pair in self.checks.items()},
        }  # fmt: skip


class _Laps:
    """Wall time of successive stages [s]."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = perf_counter()

    def over(self, stage: str) -> None:
        """End a stage now."""
        now = perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now


@dataclass(frozen=True, eq=False)
class LiveState:
    """State of the loop between turns."""

    turn: int  # turns shown so far
    shown: DeviceArray | np.ndarray  # sum of the light shown so far, [angle, r, z], on the device or NumPy
    pending: DeviceArray | np.ndarray  # light whose radicals have not reacted yet, [angle, r, z], also there or NumPy
    light: np.ndarray  # light of the next turn, [angle, r, z]
    turns: int  # number of turns for which the light is to be shown
    version: int = 0  # version of the light
    seen: Reconstruction | None = None  # the last field; None before the first
    committed: tuple[np.ndarray, ...] = ()  # fixed light of turns that begin, [angle, r, z] each; the first shows next
    values: np.ndarray | None = None  # the last estimate of the parameters, (7,); None before the first
    clear: np.ndarray | None = None  # mean level of the last images before anything cured, [row, column]
    level: np.ndarray | None = None  # mean level of the last images, [row, column]; None before the first turn
    sunk: float = 0.0  # shift of what is cured towards lower rows since it was first seen [pixels]
    images: str = ""  # digest of the last images
    doubt: str = ""  # reason why images no longer decide; empty if they do


@dataclass(frozen=True, eq=False)
class _Turn:
    """A completed turn: its number, remaining turns, the previous state; the light shown, pending and committed."""

    # clear: level of images before anything cured, and level: now; sunk: as in a state; cured: share of the planned
    # print's darkening that is seen now

    turn: int
    left: int
    before: LiveState
    shown: DeviceArray
    pending: DeviceArray
    committed: tuple[np.ndarray, ...]
    clear: np.ndarray | None
    level: np.ndarray | None
    sunk: float
    cured: float
    images: str


@dataclass(frozen=True, eq=False)
class LiveLoop:
    """Decides after every turn. Work is counted in projector evaluations: a replay then decides the same.

    Consumed inhibitor counts as dose that the resin already has. The camera cannot see light that has not reacted yet;
    that light counts as delivered.

    Args:
        tomograph: Makes fields from images.
        estimator: Estimates the response of `resin`.
        replanner: Replans the remaining light.
        resin: Assumed kinetics.
        light: The plan's light of one turn, [angle, r, z].
        planned: Turns of the plan.
        longest: Greatest number of turns that the user allows.
        iterations: Projector evaluations of the tomograph per decision.
        evaluations: Projector evaluations of the replanner per decision.
        prior: Prior of the parameters.
        ahead: Number of turns that begin before a decision can reach the projector.
        every: Number of turns from one decision to the next.
        trust: Limits within which images decide.
    """

    tomograph: Tomograph
    estimator: Estimator
    replanner: Replanner
    resin: CuringResin
    light: np.ndarray
    planned: int
    longest: int
    iterations: int = 8
    evaluations: float = 8.0
    prior: Prior = field(default_factory=lambda: Prior.of(None, USUAL))
    ahead: int = 0
    every: int = 1
    trust: Trust = field(default_factory=Trust)

    def start(self) -> LiveState:
        """The state before the first turn. It also makes tables; no turn then waits for them."""
        _ = self.tomograph.operator, self.estimator.quick, self._planned_dose, self._dark
        self.replanner.prepare(self.estimator.operator)
        light = self._planned
        dark = scaled(self.field(light), 0.0)
        return LiveState(0, dark, dark, light, self.planned - self.ahead, committed=(light,) * self.ahead)

    def decide(self, state: LiveState, frames: np.ndarray) -> tuple[LiveState, Decision]:
        """Decide after one more turn. It showed the first committed light or, if none is committed, the state's light.

        If images or estimates are rejected, only the update of this turn is lost.

        Args:
            state: The state before the turn.
            frames: Frames of the turn, gray levels [angle, row, column].

        Returns:
            The state after it, and the decision.
        """
        at, seen, laps = self._after(state, frames), state.seen, _Laps()
        repeated = at.images and at.images == state.images
        doubt = state.doubt or ("the camera repeats its images" if repeated else self.trust.of_place(at.sunk))
        try:
            if doubt:
                decision = self._by_plan(at, doubt)
            elif at.turn % self.every:
                decision = self._kept(at, f"decided after every {counted(self.every, 'turn')}")
            else:
                depths = self.tomograph.measure(frames)
                seen = self.tomograph.see(depths, seen, iterations=self.iterations)
                laps.over("see")
                doubt = self.trust.of_images(seen)
                decision = self._by_plan(at, doubt) if doubt else self._replanned(at, depths, seen, laps)
                images = seen.misfit, self.trust.limit(seen)
                decision = replace(decision, misfit=seen.misfit, checks={"images": images} | decision.checks)
        except VamError as error:
            decision = self._kept(at, f"refused: {error}")
        conversion = None if seen is None else seen.cured
        decision = replace(decision, stages=laps.seconds, conversion=conversion)
        found = np.array([value for value, _ in decision.parameters.values()]) if decision.parameters else state.values
        after = LiveState(at.turn, at.shown, at.pending, decision.light, decision.turns, decision.version, seen,
                          at.committed, found, at.clear, at.level, at.sunk, at.images,
                          decision.doubt)  # fmt: skip
        return after, decision

    def _after(self, state: LiveState, frames: np.ndarray) -> _Turn:
        fade = exp(-1.0 / self.resin.dark)
        showing, *committed = *state.committed, state.light
        made = self.resin.dark * (1.0 - fade)
        had, light = self.field(state.pending), self.field(showing)
        pending = combine(fade, had, made, light, had.device.empty(had.shape))
        shown = added(self.field(state.shown), light)
        level, clear, share = mean_level(frames, self.tomograph.camera.shape), state.clear, 0.0
        moved = state.sunk
        if level is not None:
            if clear is not None and state.level is not None:
                moved += sunk(clear - state.level, clear - level)
            share = 0.0 if clear is None else share_of(darkening(clear - level), self._dark)
            if clear is None or share < ONSET:  # darkening before anything cures is not curing
                clear = level
        left, seen = max(state.turns - 1, 0), digest(some(frames))
        last = state.level if level is None else level
        return _Turn(state.turn + 1, left, state, shown, pending, tuple(committed), clear, last, moved, share, seen)

    def field(self, values: DeviceArray | np.ndarray) -> DeviceArray:
        """An array on the device of the plan; the last few read-only arrays are kept there.

        Args:
            values: Light or a field, [i, j, z].

        Returns:
            The array, [i, j, z] on the device.
        """
        device, kept = self.estimator.operator.device, self._kept_fields
        if isinstance(values, DeviceArray) or values.flags.writeable:
            return here(device, values)
        held = kept.pop(id(values), None) or (values, device.field(values))
        kept[id(values)] = held
        if len(kept) > KEPT:
            del kept[next(iter(kept))]
        return held[1]

    @cached_property
    def _kept_fields(self) -> dict[int, tuple[np.ndarray, DeviceArray]]:
        return {}

    def corrected(self, state: LiveState, lights: Mapping[int, np.ndarray], showed: Sequence[int]) -> LiveState:
        """The state if other versions were shown than decided, for example because one came too late.

        Args:
            state: The state before a turn.
            lights: Light of the versions so far, [angle, r, z].
            showed: Versions of the turn and of those committed after it.

        Returns:
            The state for the versions shown.
        """
        *committed, light = (lights[version] for version in showed)
        return replace(state, committed=tuple(committed), light=light)

    def replay(self, turns: Iterable[np.ndarray], showed: Iterable[Sequence[int]] | None = None) -> Iterator[Decision]:
        """The decisions for recorded images, equal bit for bit to those of the print.

        Args:
            turns: Frames of each turn, [angle, row, column], in order.
            showed: Versions of each turn, as for `corrected`; None if all were shown as decided.

        Yields:
            The decision after each turn.
        """
        return (decision for _, decision in self.states(turns, showed))

    def states(
        self, turns: Iterable[np.ndarray], showed: Iterable[Sequence[int]] | None = None
    ) -> Iterator[tuple[LiveState, Decision]]:
        """The states, with the decisions of `replay`.

        Args:
            turns: As for `replay`, [angle, row, column] each.
            showed: As for `replay`.

        Yields:
            The state and the decision after each turn.
        """
        state, lights = self.start(), {0: self.light}
        for frames, versions in zip(turns, repeat(()) if showed is None else showed, strict=False):
            if versions:
                state = self.corrected(state, lights, versions)
            state, decision = self.decide(state, frames)
            lights[decision.version] = decision.light
            yield state, decision

    def _kept(self, at: _Turn, reason: str) -> Decision:
        stop, before = not at.left or at.turn + self.ahead >= self.longest, at.before
        return Decision(at.turn, "stop" if stop else "keep", before.version, before.light, at.left, reason=reason)

    def _by_plan(self, at: _Turn, doubt: str) -> Decision:
        """The planned light until images are as dark as planned, with at most the dose of the plan."""
        before, turns = at.before, self._allowed(at)
        if at.cured >= 1.0 or at.turn + self.ahead >= self.longest:
            turns = 0
        swapped = not np.array_equal(before.light, self.light)
        action = "stop" if not turns else "swap" if swapped else "keep"
        return Decision(at.turn, action, before.version + swapped, self._planned, turns,
                        reason=f"by the plan: {doubt}", doubt=doubt)  # fmt: skip

    def _allowed(self, at: _Turn) -> int:
        """Number of turns of planned light that the remaining dose of the plan allows."""
        spent = total(added(at.shown, *map(self.field, at.committed))) / total(self.field(self._planned))
        return max(floor(self.planned - spent + ROUNDING), 0)

    @cached_property
    def _planned(self) -> np.ndarray:
        light = self.light.view()
        light.setflags(write=False)
        return light

    @cached_property
    def _dark(self) -> np.ndarray:
        """Darkening of the images at which planned light ends; light in flight still reacts afterwards."""
        share = max(1.0 - (self.resin.dark + self.ahead) / self.planned, 0.0)
        cured = self.estimator.conversion(share * self._planned_dose.numpy())
        passed = self.tomograph.camera.transmitted(self.tomograph.turbidity.extinction_at(cured).astype(np.float32))
        return darkening(-np.log(np.maximum(some(passed), TINY)).mean(axis=0))

    def _replanned(self, at: _Turn, depths: OpticalDepths, seen: Reconstruction, laps: _Laps) -> Decision:
        if self._cured(seen) < ENOUGH:
            # A weak lamp must not end a print before anything is seen.
            some = max(at.left, min(1, self.longest - at.turn - self.ahead))
            return self._kept(replace(at, left=some), "nothing cured yet")
        deviation = self._deviation(depths, seen)
        laps.over("see")
        acted = added(at.shown, at.pending, factor=-1.0)
        found = self._estimated(at.before, acted, self.field(seen.cured), deviation)
        laps.over("estimate")
        checks = {"conversion": (found.unexplained, self.trust.conversion)}
        if doubt := self.trust.of_estimate(found):
            return replace(self._by_plan(at, doubt), checks=checks)
        calibrated = self.estimator.nearly(found.values, acted, found.lit)
        more = calibrated.T(added(at.pending, *map(self.field, at.committed)))
        delivered = combine(1.0, found.delivered, 1.0, more, more)
        plan = self.replanner.replan(
            calibrated, delivered, self.field(at.before.light), at.left,
            range(max(self.longest - at.turn - self.ahead, 0) + 1), evaluations=self.evaluations,
            expected_dose=self._expected_dose(float(found.values[6])),
            error=min(total(found.std) / total(found.delivered), 1.0),
        )  # fmt: skip
        decision = self._decided(at, found, plan, delivered)
        laps.over("replan")
        return replace(decision, checks=checks)

    def _cured(self, seen: Reconstruction) -> int:
        """Number of voxels in the judged cylinder with visible conversion."""
        level = float(np.nextafter(np.float32(SIGNIFICANT), np.float32(inf)))
        return int(above(Parts(seen.cured, seen.cured, -inf), level)[0, IN, 1])

    def _estimated(self, before: LiveState, acted: DeviceArray, seen: DeviceArray, deviation: DeviceArray) -> Estimate:
        """Parameters and dose of the light that has reacted, from the conversion seen and its deviation."""
        columns, slices = np.flatnonzero(self.estimator.operator.grid.cylinder()), seen.shape[2]
        count = columns.size * slices
        column, z = np.divmod(np.arange(0, count, max(count // FIRST, 1)), slices)
        some = places(acted.device, columns[column] * slices + z, seen.shape)
        even = (self.estimator.quick or self.estimator.operator).T(acted)
        gain, inhibitor = self._first_look(*(picked(field, some) for field in (even, seen, deviation)))
        start = np.array(self.prior.mean if before.values is None else before.values)
        start[0], start[6] = gain, self.resin.induction * (1.0 - inhibitor)
        return self.estimator.estimate(acted, seen, deviation, self.prior, start=start, correlated=True, common=COMMON)

    def _decided(self, at: _Turn, found: Estimate, plan: Replanned, delivered: DeviceArray) -> Decision:
        """The decision that follows from a plan of the remaining turns."""
        turns, light = plan.expected.turns, at.before.light
        swapped = not alike(plan.light, self.field(light))
        if swapped:
            light = plan.light.numpy()
            light.setflags(write=False)
            self._kept_fields[id(light)] = light, plan.light
        return Decision(
            at.turn, "stop" if not turns else "swap" if swapped else "keep", at.before.version + swapped, light, turns,
            1.0 - float(found.values[6]) / self.resin.induction, found.parameters, float(plan.expected.least),
            f"overlap {plan.expected.iou:.4f} likely, {plan.kept.iou:.4f} without",
            dose=scaled(delivered, 1.0 / self.resin.solid),
        )  # fmt: skip

    def _deviation(self, depths: OpticalDepths, seen: Reconstruction) -> DeviceArray:
        """Standard deviation of the conversion seen: noise, smoothing at edges, and errors of the models."""
        variance = self.field(self.tomograph.variance(depths, iterations=self.iterations))
        sharp = self.field(seen.cured)
        variance.device.launch(
            conversion_deviation, extinction=self.field(seen.field), sharp=sharp, rounded=self._rounding(sharp),
            **self._slopes, model=MODEL, variance=variance,
        )  # fmt: skip
        return variance

    @cached_property
    def _slopes(self) -> dict[str, DeviceArray]:
        """Slopes of the conversion, and the extinctions at which they begin, as tables."""
        resin, device = self.tomograph.turbidity, self.estimator.operator.device
        return {"knots": device.table(np.array(resin.extinction[:-1])), "slopes": device.table(resin.slopes)}

    @cached_property
    def _rounding(self) -> Smoothing:
        """Smoothing like that of edges in a reconstruction."""
        return Smoothing(self.estimator.operator.device, self.estimator.operator.grid.shape, 1.0)

    def _expected_dose(self, initial_dose: float) -> DeviceArray:
        """Dose of the whole plan, reduced for resin that has consumed inhibitor, because that counts as dose."""
        solid = self.resin.solid
        return scaled(self._planned_dose, (solid - initial_dose) / solid, initial_dose)

    @cached_property
    def _planned_dose(self) -> DeviceArray:
        A = self.estimator.operator
        return A.T(A.device.field((self.planned * self.light).astype(np.float32)))

    def _first_look(self, dose: np.ndarray, seen: np.ndarray, deviation: np.ndarray) -> tuple[float, float]:
        """Light and inhibitor, relative to the plan, that explain best what is seen; used while neither is known."""
        usual = np.log(GAINS)[:, None] ** 2 / self.prior.covariance[0, 0] + 0.0 * INHIBITORS
        used = self.resin.induction * (1.0 - INHIBITORS)[:, None]
        for row, gain in zip(usual, GAINS, strict=True):
            row += np.square((self.estimator.conversion(gain * dose + used) - seen) / deviation).sum(axis=1)
        i, k = np.unravel_index(int(np.argmin(usual)), usual.shape)
        return float(GAINS[i]), float(INHIBITORS[k])
