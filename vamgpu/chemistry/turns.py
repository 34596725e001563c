"""Species of every voxel through the turns of a print, and derivatives by the light of a turn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import prod
from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.chemistry.diffusion import Heat
from vamgpu.errors import BadInput
from vamgpu.geometry import counts, positive, resin_radius
from vamgpu.kernels.update import fill_background
from vamgpu.operators.compose import combine
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.pose_runs import PoseRuns
from vamgpu.operators.reductions import EVERYWHERE
from vamgpu.travel import at_rest

KEPT = {False: 1 << 30, True: 1 << 33}
"""Bytes of states that are kept for the derivatives, on processors and on GPUs. Beyond them, only the states at the
beginnings of turns are kept, and the others are computed again."""

Fields = tuple[DeviceArray, ...]


class Turns(ABC):
    """Species that react and diffuse through turns of the same light, run of angles by run, with exact adjoints."""

    # With diffusion, half the light of a substep comes before it and half after (Strang): reactions then use up at once
    # what diffuses. air: faces where the first species is held at 0.

    def __init__(
        self, operators: Sequence[LinearOperator], turns: int, period: float, runs: int, steps: int,
        diffusivities: Sequence[float], air: Sequence[str] = (),
    ) -> None:  # fmt: skip
        first: Any = operators[0]
        self.device: Device = first.device
        self.turns: int = counts("turns", (turns,), 1)[0]
        self.period: float = positive("period [s]", period, zero=True)
        self.steps: int = counts("steps", (steps,), 1)[0]
        self.runs: tuple[PoseRuns, ...] = tuple(PoseRuns(A, runs) for A in operators)
        self._shape: tuple[int, int, int] = first.domain.shape
        self.diffusivities: tuple[float, ...] = tuple(positive("diffusivity [mm²/s]", D, zero=True)
                                                      for D in diffusivities)  # fmt: skip
        if any(self.diffusivities):
            check_times(first.motion, self.period, "species diffuse")
        wall = resin_radius(getattr(first, "vessel", None))
        seconds = self.period / self._substeps
        self._heats: list[Heat | None] = [
            Heat(first.grid, D * seconds, self.device, faces, wall) if D else None
            for D, faces in zip(self.diffusivities, (air, *[()] * len(self.diffusivities)), strict=False)
        ]
        self._halved: bool = any(self.diffusivities)
        self._inward: Heat | None = None  # from means over voxels to values at their centers, for light
        self._doses: list[Fields] = []  # of the runs, then, with diffusion, the means of every run and the next one
        self._starts: list[Fields] = []
        self._path: list[Fields] = []
        self._block = -1  # turns whose states the path holds

    @abstractmethod
    def _start(self) -> Fields:
        """New fields of the species, and of X, before the first turn."""

    @abstractmethod
    def _react(self, dose: Fields, share: float, before: Fields, after: Fields) -> None:
        """The reaction of a share of a substep; fields of species and X."""

    @abstractmethod
    def _react_back(
        self, dose: Fields, share: float, species: Fields, slopes: Fields, x_slope: DeviceArray, by_dose: Fields
    ) -> None:  # fmt: skip
        """Derivatives by the species after a reaction become those before it; those by the dose are added."""

    @property
    def _substeps(self) -> int:
        return len(self.runs[0]) * self.steps

    @property
    def _last(self) -> int:
        """Number of the last reaction; with diffusion, it is the second half of a substep."""
        return self._substeps * self.turns - 1 + self._halved

    @property
    def _blocks(self) -> int:
        """Number of parts whose states are kept at a time."""
        size = 4 * prod(self._shape) * len(self.diffusivities) * self._substeps * self.turns
        return 1 if size <= KEPT[self.device.is_gpu] else self.turns

    def _reaction(self, number: int) -> tuple[int, float]:
        """Which dose a reaction gets, and the share of a substep that it takes."""
        runs, last = len(self.runs[0]), self._substeps * self.turns
        run = number % self._substeps // self.steps
        if not self._halved:
            return run, 1.0
        before = (number - 1) % self._substeps // self.steps
        if number in (0, last):
            return (run if number == 0 else before), 0.5
        return (run if run == before else runs + before), 1.0

    def _through(self, light: Sequence[DeviceArray], each: Any = None) -> Fields:
        """New fields of species and X after the last turn; ``each`` gets those after every reaction."""
        self._light_up(light)
        if self._path:
            return self._kept(each)
        *species, x = self._start()
        ends = self._volumes(len(species))
        copy_all(species, ends)
        self._follow(range(self._last + 1), [ends] * (self._last + 2), x, each)
        return *ends, x

    def _kept(self, each: Any = None) -> Fields:
        """The fields of `_through`, with the states kept, which only derivatives need."""
        if not self._path:
            length = self._substeps * self.turns // self._blocks + self._halved
            self._path = [self._volumes(len(self._heats)) for _ in range(length)]
            self._starts = [self._path[0] if self._blocks == 1 else self._volumes(len(self._heats))
                            for _ in range(self._blocks)]  # fmt: skip
        *species, x = self._start()
        ends = tuple(species)
        for block in range(self._blocks):
            copy_all(ends, self._starts[block])
            ends = self._fill(block, x, self._volumes(len(ends)), each)
        return *ends, x

    def _numbers(self, block: int) -> range:
        """Reactions of a block of turns."""
        each = self._substeps * self.turns // self._blocks
        return range(block * each, (block + 1) * each + (self._halved and block == self._blocks - 1))

    def _fill(self, block: int, x: DeviceArray, ends: Fields, each: Any = None) -> Fields:
        """Compute the states before the reactions of a block of turns; return ``ends``, the species after it."""
        copy_all(self._starts[block], self._path[0])
        numbers = self._numbers(block)
        self._follow(numbers, [*self._path[: len(numbers)], ends], x, each)
        self._block = block
        return ends

    def _follow(self, numbers: range, states: list[Fields], x: DeviceArray, each: Any) -> None:
        """Compute the species after every reaction and its diffusion from those before; they may be the same fields."""
        for number, before, after in zip(numbers, states, states[1:], strict=False):
            dose, share = self._reaction(number)
            self._react(self._doses[dose], share, (*before, x), (*after, x))
            if each is not None:
                each(number, (*after, x))
            if number < self._last:
                self._diffuse(after)

    def _back(self, slopes: Fields, x_slope: DeviceArray, each: Any = None) -> tuple[DeviceArray, ...]:
        """Derivatives by light from those by the last fields; ``each`` may add to those by fields after a reaction."""
        if not self._doses:
            raise BadInput("no light was exposed before the gradient; call expose() first")
        if not self._path:
            self._kept()
        by_dose = [tuple(self._constant(0.0) for _ in self.runs) for _ in self._doses]
        for block in reversed(range(self._blocks)):
            if block != self._block:
                self._fill(block, self._constant(1.0), self._volumes(len(slopes)))
            numbers = self._numbers(block)
            for number in reversed(numbers):
                dose, share = self._reaction(number)
                before = self._path[number - numbers[0]]
                if each is not None:
                    each(number, (*slopes, x_slope))
                self._react_back(self._doses[dose], share, before, slopes, x_slope, by_dose[dose])
                if number:
                    self._diffuse(slopes, back=True)
        return self._by_light(by_dose)

    def _by_light(self, by_dose: list[Fields]) -> tuple[DeviceArray, ...]:
        """Derivatives by the light from those by the doses of runs and by their means."""
        count, found = len(self.runs[0]), tuple(self.device.empty(runs.whole.range.shape) for runs in self.runs)
        means = by_dose[count:]
        for run in range(count):
            for color, (runs, light) in enumerate(zip(self.runs, found, strict=True)):
                slope = by_dose[run][color]
                for mean in (means[run], means[run - 1]) if means else ():
                    combine(1.0, slope, 0.5, mean[color], slope)
                if self._inward is not None:
                    self._inward.spread(slope, back=True)
                runs.project(run, slope, light)
        return found

    def _light_up(self, light: Sequence[DeviceArray]) -> None:
        """Doses of every run of a turn, the same in every turn, and their means."""
        count = len(self.runs[0])
        if not self._doses:
            self._doses = [self._volumes(len(self.runs)) for _ in range(count * (1 + self._halved))]
        for run in range(count):
            for runs, part, dose in zip(self.runs, light, self._doses[run], strict=True):
                runs.expose(run, part, dose)
                if self._inward is not None:
                    self._inward.spread(dose)
        for run, means in enumerate(self._doses[count:]):
            for mean, one, other in zip(means, self._doses[run], self._doses[(run + 1) % count], strict=True):
                combine(0.5, one, 0.5, other, mean)

    def _diffuse(self, fields: Fields, back: bool = False) -> None:
        for field, heat in zip(fields, self._heats, strict=True):
            if heat is not None:
                heat.spread(field, back)

    def _volumes(self, count: int) -> Fields:
        return tuple(self.device.empty(self._shape) for _ in range(count))

    def _constant(self, value: float) -> DeviceArray:
        filled = self.device.empty(self._shape)
        self.device.launch(fill_background, target=self._doses[0][0], low=value, high=value, reach=EVERYWHERE,
                           model=filled)  # fmt: skip
        return filled


def check_times(motion: Any, period: float, why: str) -> None:
    """Reject a model that needs times and has none, or unequal ones; ``why`` names what takes time."""
    if not period:
        raise BadInput(f"{why}, which takes time; expected period > 0, the time of a turn [s]")
    at_rest("a model of the resin through all turns", motion)
    if motion.dwell is not None:
        raise BadInput(f"{why}, but {motion} angles are lit for unequal times; expected equal times: leave dwell out "
                       "of Turntable")  # fmt: skip


def copy_all(fields: Sequence[DeviceArray], out: Sequence[DeviceArray]) -> None:
    """Copy fields, except those that are already there."""
    for field, kept in zip(fields, out, strict=True):
        if kept is not field:
            combine(1.0, field, 0.0, field, kept)
