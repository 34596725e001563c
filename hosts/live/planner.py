"""The planning function of a monitored print: a `LiveLoop` in the planning process, and the record of its decisions.

Images of turn t show the effect of earlier turns; a decision late in turn t takes effect from t + 1 on.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.live.worker import PlannerClient
from vamgpu.live import Decision, LiveRecord, LiveSetup
from vamgpu.live.loop import LiveState
from vamgpu.live.maps import BRIGHT, cuts
from vamgpu.live.prior import NAMES
from vamgpu.live.sensor import BeamImages, SensorView
from vamgpu.operators.projection import Projection
from vamgpu.printing.folder import load_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.pack import pack
from vamgpu.printing.placement import FIT
from vamgpu.storage.folder import Folder

PLACE = "live"  # folder of the record in the run's folder
SEEN = 0.6  # share of a turn whose images are used, more than half of it; the rest is for planning and upload


def light_of(frames: Frames, planned: int, dose: float = 1.0) -> np.ndarray:
    """Light of one of ``planned`` turns of frames, in units of the resin's dose, [angle, r, z]."""
    return (np.asarray(frames.irradiance().numpy(), float) * (dose / planned)).astype(np.float32)


def levels_of(light: np.ndarray, frames: Frames, planned: int, operator: Projection, dose: float = 1.0) -> np.ndarray:
    """Levels that show the light of a turn on the projector of a job's frames, [frame, row, column]."""
    if not light.any():
        return np.zeros(frames.shape, np.uint8)
    plan: Any = SimpleNamespace(
        sinogram=operator.device.upload((planned / dose * light).astype(np.float32)), operator=operator
    )  # fmt: skip
    placed = frames.settings
    other = "error-diffusion" if frames.bits == 1 else "round"
    dither = other if placed.dither == FIT else placed.dither  # fitting by dose takes longer than a turn
    return pack(
        plan, bits=frames.bits, gray=frames.gray, flat_field=frames.flat_field, flip_r=placed.flip_r,
        flip_z=placed.flip_z, shift=placed.shift, dither=dither, scale=frames.scale,
    ).levels()  # fmt: skip


def follow(planner: PlannerClient) -> None:
    """Plan every turn of a print with the `LiveSetup` in the order's settings, and record why."""
    Following(planner).run()


class Following:
    """One monitored print, from its start or from where an earlier host left it."""

    def __init__(self, planner: PlannerClient) -> None:
        self._planner, task = planner, planner.task
        self._setup = setup = LiveSetup.of(dict(task["settings"]["setup"]))
        view = task["settings"]["view"]
        self._images = None if view is None else BeamImages(SensorView(**view), setup.pixels)
        job = task["jobs"][0]
        self._frames = load_frames(job, "numpy")
        light = light_of(self._frames, setup.planned, setup.dose)
        self._part = part = np.array(Folder.open(job).array("target"), np.float32)
        self._record = LiveRecord(Path(task["folder"]) / PLACE)
        self._resumed = self._record.begun
        self._loop = self._record.loop() if self._resumed else self._record.begin(setup, part, light)
        self._lights = {0: light}
        self._own = {0: 0}  # version of the print → version of the loop
        self._proposed: list[tuple[int, int, float]] = []  # version of the loop, turn and time of each proposal
        self._unseen: dict[int, int] = {}  # the turn after which each version of the print was decided
        self._showed: dict[int, int] = {}  # version of the print in each turn
        self._turn, self._stop, self._over = 0, 0, False
        self._state = self._restored() if self._resumed else self._loop.start()

    def _restored(self) -> LiveState:
        """The state after the recorded turns, from their repeated decisions; the last one stays in effect."""
        told, state, numbers = self._record.decisions, self._loop.start(), {0: 0}
        for was, (after, decision) in zip(told, self._record.states(self._loop), strict=True):
            state, self._over = after, decision.action == "stop"
            self._lights[decision.version] = decision.light
            if "number" in was:
                self._own[int(was["number"])] = decision.version
                numbers[decision.version] = int(was["number"])
            for turn, version in zip((decision.turn - 1, decision.turn), was["showed"], strict=True):
                self._showed[turn] = numbers.get(int(version), 0)
        return state

    def run(self) -> None:
        """Run until the print is over."""
        if not self._resumed:
            self._propose(0, self._state.light, 1, self._setup.planned)
        stack, first, seen = self._blank(), 0, -1  # of several images of an angle, the first is used
        for told in self._planner:
            if "answer" in told:
                self._answered(told["answer"])
            elif "shown" in told:
                for slot, version in zip(told["shown"]["slot"], told["shown"]["version"], strict=True):
                    self._showed[turn := int(slot) // self._planner.task["frames"]] = int(version)
                    if (decided := self._unseen.pop(int(version), 0)) > 0:
                        self._record.note(decided, effective=turn)
            elif "image" in told and not self._over:
                turn, rest = divmod(float(told["angle"]) / 360.0, 1.0)
                if turn != self._turn:
                    self._turn, stack, first = int(turn), self._blank(), told["at"]
                if self._turn == self._state.turn + 1:
                    if (angle := int(rest * len(stack))) != seen and np.isnan(stack[angle]).all():
                        stack[angle], seen = self._image(told["image"]), angle
                    if rest >= SEEN:
                        self._decide(stack, 1e-9 * (told["at"] - first))
                elif self._turn > self._state.turn + 1:  # a turn passed without images
                    self._decide(self._blank(), 0.0)

    def _image(self, image: np.ndarray) -> np.ndarray:
        """An image on the pixels of the beam. Raises `BadInput`, `ShapeMismatch`."""
        if self._images is not None:
            return self._images(image)
        if image.shape != self._setup.pixels[::-1]:
            raise BadInput(f"the camera's images are {image.shape}; expected {self._setup.pixels[::-1]}, the pixels of "
                           "the beam: describe the camera in [[feedback]], and run vam calibrate live")  # fmt: skip
        return image

    def _blank(self) -> np.ndarray:
        return np.full((self._setup.angles, self._setup.pixels[1], self._setup.pixels[0]), np.nan, np.float32)

    def _decide(self, stack: np.ndarray, sense: float) -> None:
        began, state, turn = time.perf_counter(), self._state, self._state.turn + 1
        shown = [self._own.get(self._showed.get(each, 0), 0) for each in (turn - 1, turn)]
        state = self._loop.corrected(state, self._lights, shown)
        self._state, decision = self._loop.decide(state, stack)
        self._lights[decision.version] = decision.light
        decided = time.perf_counter()
        checks = [(name, turn, *pair) for name, pair in decision.checks.items()]
        self._planner.checked(checks, "" if state.doubt else decision.doubt)
        self._told(decision)
        packed = time.perf_counter()
        decision = replace(decision, stages={"sense": sense} | decision.stages | {"pack": packed - decided})
        effective = None if decision.action == "swap" else turn + 1  # for a swap it is known once it is shown
        self._record.add(stack, decision, showed=shown, effective=effective, seconds=round(packed - began, 3))

    def _told(self, decision: Decision) -> None:
        begin = decision.turn + 1
        self._over = decision.action == "stop"  # for good: dark resin does not show whether to continue
        if not (self._over and self._stop == begin) and begin < self._planner.task["turns"]:
            stop = min(begin + max(decision.turns, 1), self._planner.task["turns"])
            light = decision.light if decision.turns else np.zeros_like(decision.light)
            if decision.action != "keep" or stop != self._stop:
                self._propose(decision.version, light, begin, stop)
        if decision.parameters:
            self._planner.estimate(self._found(decision), self._maps(decision))

    def _found(self, decision: Decision) -> list[Any]:
        """Parameters with deviations and expected ranges (the plan's value ± two prior deviations), and facts."""
        prior, induction = self._loop.prior, self._setup.resin.induction
        names, sigma = (*NAMES, "turbidity"), [*np.sqrt(np.diag(prior.covariance)), self._setup.turbidity.error]
        usual = {name: (m - 2.0 * s, m + 2.0 * s) for name, m, s in zip(names, [*prior.mean, 1.0], sigma, strict=True)}
        found = [(name, *pair, *usual.get(name, ())) for name, pair in decision.parameters.items()]
        less, more = (1.0 - each / induction for each in usual["initial_dose"])
        error = decision.parameters["initial_dose"][1] / induction
        facts = ("estimated after turn", decision.turn), ("expected stop [turn]", decision.turn + 1 + decision.turns)
        return [
            *found, ("inhibitor", decision.inhibitor, error, min(less, more), max(less, more)),
            *((name, value, 0.0) for name, value in facts),
        ]  # fmt: skip

    def _maps(self, decision: Decision) -> dict[str, np.ndarray]:
        drawn = {}
        if decision.dose is not None:
            drawn[f"dose; brightest is {BRIGHT:g} times what solidifies"] = cuts(decision.dose, self._part, BRIGHT)
        if decision.conversion is not None:
            drawn["conversion seen"] = cuts(decision.conversion, self._part, 1.0, "viridis")
        return drawn

    def _propose(self, version: int, light: np.ndarray, turn: int, stop: int) -> None:
        setup, operator = self._setup, self._loop.estimator.operator
        levels = levels_of(light, self._frames, setup.planned, operator, setup.dose)
        self._proposed.append((version, turn - 1, time.perf_counter()))
        self._planner.propose([levels], turn, stop)
        self._stop = stop

    def _answered(self, answer: dict[str, Any]) -> None:
        version, turn, began = self._proposed.pop(0) if self._proposed else (0, 0, 0.0)
        if "number" in answer:
            self._own[number := int(answer["number"])] = version
            self._unseen[number] = turn
            if turn:
                self._record.note(turn, {"upload": time.perf_counter() - began}, number=number)
