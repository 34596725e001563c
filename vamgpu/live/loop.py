"""Measure, estimate, replan, swap: the decision after every turn, a pure function of the images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import repeat
from math import exp, floor, hypot, inf
from time import perf_counter
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import VamError
from vamgpu.kernels.watch import conversion_deviation
from vamgpu.live.darkness import Darkening, Darkness
from vamgpu.live.estimate import Estimate, Estimator
from vamgpu.live.fields import added, alike, here, lowered, picked, places, scaled
from vamgpu.live.printer import CuringResin
from vamgpu.live.prior import NAMES, Prior
from vamgpu.live.replan import Replanned, Replanner
from vamgpu.live.sinking import Sinking
from vamgpu.live.smoothing import Smoothing
from vamgpu.live.tomography import OpticalDepths, Reconstruction, Tomograph
from vamgpu.live.trust import Trust, darkening, digest, mean_level, share_of, some
from vamgpu.metrics.histogram import above
from vamgpu.metrics.parts import IN, Parts
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import total
from vamgpu.quantity import counted

SIGNIFICANT = 0.1  # smallest conversion that counts as seen
ENOUGH = 50  # smallest number of such voxels for an estimate
MODEL = 0.1  # error of the conversion from resin and tomograph, in addition to the noise
COMMON = 0.05  # relative error of the seen conversion, common to all voxels
FIRST = 1000  # greatest number of voxels of the first estimate
USUAL = {"absorption": 0.1, "across": 0.05, "height": 0.05, "initial_dose": 0.2, "sensitivity": 0.2}
"""Standard deviations of parameters that a blurred field hardly distinguishes, and of the inhibitor that a vial's
age consumed; [mm] or dimensionless."""
GAINS = np.geomspace(0.5, 2.0, 41)
INHIBITORS = np.linspace(0.4, 1.1, 36)
"""Values of light and inhibitor, relative to the plan, to try before the other parameters are estimated."""
ROUNDING = 1e-3  # tolerance, in turns, of sums of light
ONSET, EARLY = 0.02, 0.1
"""Shares of the planned print's darkening: below the first, nothing has cured; above the second, this is not tested."""
KEPT = 4  # number of lights whose copies on the device are kept


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
        doubt: Reason why the images are no longer used; empty if they are. The planned light then continues until
            images are as dark as in the planned print, with at most the plan's dose, and no overlap is predicted.
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
    sinking: Sinking = Sinking()  # how what is cured sinks
    images: str = ""  # digest of the last images
    doubt: str = ""  # reason why the images are no longer used; empty if they are
    darkness: tuple[Darkness, ...] = ()  # of each turn with images: darkness, and planned dose of some voxels


@dataclass(frozen=True, eq=False)
class _Turn:
    """A completed turn: the state after it, with the light decided before, and what is known without its images."""

    # the state's shown and pending light is as far below where it was shown as the part has sunk

    state: LiveState
    left: int  # remaining turns
    acted: DeviceArray  # light that has reacted
    even: DeviceArray  # its dose as planned
    cured: float  # share of the planned print's darkening now


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
        trust: Limits within which the images are used.
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
        camera = self.tomograph.camera
        self.tomograph.variance(np.broadcast_to(camera.open_field, camera.shape), iterations=self.iterations)
        _ = self.estimator.quick, self._dark
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
        repeated = at.state.images and at.state.images == state.images
        doubt = state.doubt or ("the camera repeats its images" if repeated else "")
        try:
            if doubt:
                decision = self._by_plan(at, doubt)
            elif at.state.turn % self.every:
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
        cured = decision.conversion or (None if seen is None else seen.cured)
        decision = replace(decision, stages=laps.seconds, conversion=cured)
        found, sinking = state.values, at.state.sinking
        if told := decision.parameters:
            found, sinking = np.array([told[name][0] for name in NAMES]), self._sinking(at, told["height"])
        decided = {name: getattr(decision, name) for name in ("light", "turns", "version", "doubt")}
        return replace(at.state, seen=seen, values=found, sinking=sinking, **decided), decision

    def _after(self, state: LiveState, frames: np.ndarray) -> _Turn:
        fade = exp(-1.0 / self.resin.dark)
        showing, *committed = *state.committed, state.light
        made = self.resin.dark * (1.0 - fade)
        had, light = (lowered(self.field(each), state.sinking.speed) for each in (state.pending, state.shown))
        sinking = state.sinking.turned(self._turns_of(light))
        pending = combine(fade, had, made, self.field(showing), had.device.empty(had.shape))
        shown = added(light, self.field(showing))
        acted = added(shown, pending, factor=-1.0)
        even, darkness = (self.estimator.quick or self.estimator.operator).T(acted), state.darkness
        level, last, clear = mean_level(frames, self.tomograph.camera.shape), state.level, state.clear
        share = 0.0
        if level is not None:
            darkness = *darkness, self._darkening.seen(level, even)
            clear, last = (level, level) if clear is None or last is None else (clear, last)
            share, more = (share_of(darkening(each - level), self._dark) for each in (clear, last))
            if share < EARLY and more < ONSET:  # a bubble or dust stays as dark as it was; resin that cures does not
                clear = level
            last = level
        after = replace(state, turn=state.turn + 1, shown=shown, pending=pending, committed=tuple(committed),
                        clear=clear, level=last, sinking=sinking, images=digest(some(frames)),
                        darkness=darkness)  # fmt: skip
        return _Turn(after, max(state.turns - 1, 0), acted, even, share)

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

    def states(
        self, turns: Iterable[np.ndarray], showed: Iterable[Sequence[int]] | None = None
    ) -> Iterator[tuple[LiveState, Decision]]:
        """The decisions for recorded images, equal bit for bit to those of the print, with the states.

        Args:
            turns: Frames of each turn, [angle, row, column], in order.
            showed: Versions of each turn, as for `corrected`; None if all were shown as decided.

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
        stop, now = not at.left or at.state.turn + self.ahead >= self.longest, at.state
        return Decision(now.turn, "stop" if stop else "keep", now.version, now.light, at.left, reason=reason)

    def _by_plan(self, at: _Turn, doubt: str) -> Decision:
        """The planned light until images are as dark as planned, with at most the dose of the plan."""
        now = at.state
        spent = self._turns_of(added(self.field(now.shown), *map(self.field, now.committed)))
        turns = max(floor(self.planned - spent + ROUNDING), 0)
        if at.cured >= 1.0 or now.turn + self.ahead >= self.longest:
            turns = 0
        swapped = not np.array_equal(now.light, self.light)
        action = "stop" if not turns else "swap" if swapped else "keep"
        return Decision(now.turn, action, now.version + swapped, self._planned, turns,
                        reason=f"by the plan: {doubt}", doubt=doubt)  # fmt: skip

    def _turns_of(self, light: DeviceArray) -> float:
        """Light in planned turns."""
        return total(light) / total(self.field(self._planned))

    def _sinking(self, at: _Turn, height: tuple[float, float]) -> Sinking:
        """How the part sinks, by the height of the light so far above it, and its deviation [mm]."""
        distance, error = np.array(height) / self.estimator.operator.beam.pitch
        return at.state.sinking.estimated(-distance, error, self._turns_of(at.acted))

    @cached_property
    def _planned(self) -> np.ndarray:
        light = self.light.view()
        light.setflags(write=False)
        return light

    @cached_property
    def _dark(self) -> np.ndarray:
        """Darkening of the images at which planned light ends."""
        return darkening(self._darkening.depth)

    @cached_property
    def _darkening(self) -> Darkening:
        """Darkening of the planned print when its light ends; radicals still react afterwards."""
        share = max(1.0 - (self.resin.dark + self.ahead) / self.planned, 0.0)
        return Darkening(self.tomograph, self.estimator.conversion, scaled(self._planned_dose, share))

    def _replanned(self, at: _Turn, depths: OpticalDepths, seen: Reconstruction, laps: _Laps) -> Decision:
        level = float(np.nextafter(np.float32(SIGNIFICANT), np.float32(inf)))
        if above(Parts(seen.cured, seen.cured, -inf), level)[0, IN, 1] < ENOUGH:  # of the judged cylinder
            # A weak lamp must not end a print before anything is seen.
            some = max(at.left, min(1, self.longest - at.state.turn - self.ahead))
            return self._kept(replace(at, left=some), "nothing cured yet")
        turbid, unsure = self._darkening.turbidity(at.state.darkness, self.prior)
        field = scaled(seen.field, 1.0 / turbid)
        cured = self.tomograph.conversion(field)
        deviation = self._deviation(depths, field, cured, turbid)
        laps.over("see")
        found = self._estimated(at, cured, deviation, unsure / turbid)
        laps.over("estimate")
        told = {"checks": {"conversion": (found.unexplained, self.trust.conversion)}, "conversion": cured}
        if doubt := self.trust.of_estimate(found):
            return replace(self._by_plan(at, doubt), **told)
        sinking = self._sinking(at, found.parameters["height"])
        longest = max(self.longest - at.state.turn - self.ahead, 0)
        A, height = self.estimator.operator, None
        if speed := sinking.speed * A.beam.pitch:
            longest = min(longest, max(at.left, 1))  # in further turns the part would sink further
            height = -0.5 * speed * longest
        calibrated = self.estimator.nearly(found.values, at.acted, found.lit, height)
        more = calibrated.T(added(self.field(at.state.pending), *map(self.field, at.state.committed)))
        delivered = combine(1.0, found.delivered, 1.0, more, more)
        turns = self.ahead, self.ahead + longest
        ended, going_on = (lowered(delivered, speed * each / A.grid.pitch) for each in turns)
        solid, consumed = self.resin.solid, float(found.values[6])  # inhibitor that is gone counts as dose
        gel_error = min(hypot(self.resin.gel_error, unsure / turbid), 1.0)
        plan = self.replanner.replan(
            calibrated, going_on, self.field(at.state.light), at.left,
            range(longest + 1), evaluations=self.evaluations,
            expected_dose=scaled(self._planned_dose, (solid - consumed) / solid, consumed),
            error=min(total(found.std) / total(found.delivered), 1.0),
            thresholds=replace(self.resin, gel_error=gel_error).solid_doses, stopped=ended,
        )  # fmt: skip
        decision = self._decided(at, found, plan, delivered)
        laps.over("replan")
        fitted = {"turbidity": (turbid, unsure)} if unsure else {}
        fitted["sinking"] = sinking.found * A.beam.pitch, sinking.error * A.beam.pitch
        return replace(decision, parameters=found.parameters | fitted, **told)

    def _estimated(self, at: _Turn, seen: DeviceArray, deviation: DeviceArray, unsure: float) -> Estimate:
        """Parameters and dose of the light that has reacted, from the conversion seen, its deviation and scale."""
        columns, slices = np.flatnonzero(self.estimator.operator.grid.cylinder()), seen.shape[2]
        count = columns.size * slices
        column, z = np.divmod(np.arange(0, count, max(count // FIRST, 1)), slices)
        some = places(seen.device, columns[column] * slices + z, seen.shape)
        gain, inhibitor = self._first_look(*(picked(field, some) for field in (at.even, seen, deviation)))
        start = np.array(self.prior.mean if at.state.values is None else at.state.values)
        start[0], start[6] = gain, self.resin.induction * (1.0 - inhibitor)
        common = hypot(COMMON, unsure)
        return self.estimator.estimate(at.acted, seen, deviation, self.prior, start=start, correlated=True,
                                       common=common)  # fmt: skip

    def _decided(self, at: _Turn, found: Estimate, plan: Replanned[DeviceArray], delivered: DeviceArray) -> Decision:
        """The decision that follows from a plan of the remaining turns."""
        turns, light = plan.expected.turns, at.state.light
        swapped = not alike(plan.light, self.field(light))
        if swapped:
            light = plan.light.numpy()
            light.setflags(write=False)
            self._kept_fields[id(light)] = light, plan.light
        return Decision(
            at.state.turn, "stop" if not turns else "swap" if swapped else "keep", at.state.version + swapped, light,
            turns, 1.0 - float(found.values[6]) / self.resin.induction, iou=float(plan.expected.least),
            reason=f"overlap {plan.expected.iou:.4f} likely, {plan.kept.iou:.4f} without",
            dose=scaled(delivered, 1.0 / self.resin.solid),
        )  # fmt: skip

    def _deviation(self, depths: OpticalDepths, field: DeviceArray, sharp: DeviceArray, turbid: float) -> DeviceArray:
        """Standard deviation of the conversion seen: noise, smoothing at edges, and errors of the models."""
        variance = scaled(self.field(self.tomograph.variance(depths, iterations=self.iterations)), turbid**-2)
        variance.device.launch(
            conversion_deviation, extinction=self.field(field), sharp=sharp, rounded=self._rounding(sharp),
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
