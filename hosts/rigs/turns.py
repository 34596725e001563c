"""Turns of a vial: as many as the proved exposure needs, dimmed to give the proved dose."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, DoseWarning, StorageError, TimingInfeasible
from vamgpu.hosts.rigs.jobs import PrintJob
from vamgpu.hosts.rigs.roles import LightPart
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.jobs.run import Proven, prove
from vamgpu.printing.given_dose import GivenDose, ProvedDose
from vamgpu.quantity import counted
from vamgpu.storage.folder import Folder
from vamgpu.travel import Travel

SLOTS = 10**7  # Most frames of a print; more are a typing error
CLOSE = 1e-3  # Share of a turn below which frames are not dimmed
MICRO = 1000  # Machines light frames for whole microseconds [ns]


def proved(jobs: tuple[PrintJob, ...], turns: int | None, speed: float, device: str | Device | None) -> Proven | str:
    """The proof of a vial's job for these turns, or why its exposure is not known. Raises as `prove` does."""
    path = jobs[0].path
    if len(jobs) > 1:
        return f"{len(jobs)} projectors share the dose, and each job is proved separately"
    inputs = Folder.open(path).manifest.inputs
    oxygen = inputs.get("geometry", {}).get("oxygen")
    if oxygen and (turns != oxygen["turns"] or abs(speed * oxygen["period"] / 360.0 - 1.0) > CLOSE):
        shown = counted(turns, "turn") if turns is not None else "no --turns and turns"
        raise BadInput(f"{path!r} follows oxygen through {counted(oxygen['turns'], 'turn')} of {oxygen['period']:g} s, "
                       f"and this print has {shown} of {360.0 / speed:.4g} s; print it with --turns {oxygen['turns']} "
                       f"--speed {360.0 / oxygen['period']:.6g}, or solve it again with the turns and the period of "
                       "this print in [resin.oxygen]")  # fmt: skip
    if not inputs.get("print"):
        return f"{path!r} has no [print] with irradiance and critical_dose"
    if inputs.get("colors"):
        return f"{path!r} has two colors, for which proofs have no exposure"
    try:
        return prove(path, device if isinstance(device, str) else None)
    except StorageError as error:
        return str(error)


@dataclass(frozen=True)
class Turning:
    """The turns of a vial on a rig."""

    of: Callable[[float, int], Schedule]  # makes the schedule of a speed and a number of turns
    speed: float  # [deg/s]
    light: LightPart
    scale: float  # irradiance of a full-on pixel of the frames
    least: int | None  # shortest light of a frame [ns]; None on a video cable
    speeds: Sequence[float] = ()  # speeds at which a video cable and the rig can print [deg/s], the nearest first
    usual: bool = False  # whether the user left the speed out: a slower one may then give the dose
    travel: Travel | None = None  # path of a part that moves, which sets the turns

    def schedule(self, turns: int | None, known: Callable[[], ProvedDose | str]) -> tuple[Schedule, GivenDose | None]:
        """Return the slots and their dose; BadInput for a dose outside the verdict that the user did not choose."""
        try:
            once = self.of(self.speed, 1)
        except TimingInfeasible as error:
            if not self.speeds:
                raise
            raise TimingInfeasible(*self._fitted(error, turns, known)) from error
        self._check(turns or 1, once, "")
        proved = known()
        if isinstance(proved, str):
            turns = turns or self._set
            if not turns:
                raise BadInput(f"{proved}, so its number of turns is not known; expected a number: "
                               "give --turns (turns= in Python), or solve the job with [print]")  # fmt: skip
            return self.of(self.speed, turns), None
        dims = self.least is not None or self.light.gate == "controller"
        speed = self.speed
        if self.usual and turns is None and not dims:
            slower = sorted((each for each in self.speeds if each <= speed), reverse=True)
            speed = self._fitting(proved, slower) or speed
        elif self.usual and self._set:  # a helix turns slowly enough for its dose
            speed *= min(1.0, self._set / self._turns(proved, speed)[0])
        once = self.of(speed, 1)
        need = self._need(proved, once)
        exact, lit = need / self._lit(once), 1.0
        if turns is None:
            count = self._set or max(round(exact), 1)
            if dims and abs(count / exact - 1.0) > CLOSE:
                count = self._set or max(ceil(exact), 1)
                lit = exact / count
        else:
            count = turns
        self._check(count, once, f": its exposure takes {proved.seconds:.3g} s of full light")
        found, lit = self._dimmed(self.of(speed, count), lit)
        share = self._lit(found) * count / need
        dose = GivenDose(proved, share, count, found.duration / SECOND, lit, self.least is None, turns is not None)
        if not dose.keeps:
            self._off(dose, exact, once)
        return found, dose

    def _fitted(
        self, error: TimingInfeasible, turns: int | None, known: Callable[[], ProvedDose | str]
    ) -> tuple[str, str, float, str]:
        """The error of a speed at which images do not take whole slots, with one that also gives the proved dose."""
        proved = known() if turns is None else ""
        speed, told = self.speeds[0], ""
        if not isinstance(proved, str):
            if (fitting := self._fitting(proved, self.speeds)) is None:
                exact, count = self._turns(proved, speed)
                told = f" --turns {count}, for {count / exact:.3f} times the proved dose"
            speed = fitting or speed
        why = str(error).partition(": turn at")[0]
        how = f"print with --speed {speed:.6g}{told}"
        if self.travel is not None and self.travel.period is not None:
            how = f'solve the job with period = "{360.0 / speed:.6g} s" in [travel]'
        return f"{why}: {how}", error.limit, speed, error.unit

    @property
    def _set(self) -> int:
        """Turns of the path; 0 for a part at rest."""
        return 0 if self.travel is None else self.travel.turns

    def _need(self, proved: ProvedDose, once: Schedule) -> float:
        """Seconds of full drive for each frame."""
        full = self.light.irradiance or proved.irradiance
        return proved.seconds * proved.irradiance / full * self.scale / proved.scale / once.frames

    def _fitting(self, proved: ProvedDose, speeds: Sequence[float]) -> float | None:
        """The first of some speeds at which whole turns give the proved dose; None without one."""
        for speed in speeds:
            exact, count = self._turns(proved, speed)
            if proved.least <= count / exact <= proved.most:
                return speed
        return None

    def _turns(self, proved: ProvedDose, speed: float) -> tuple[float, int]:
        """Turns of the proved dose at one of the speeds, and the nearest whole number of them."""
        once = self.of(speed, 1)
        exact = self._need(proved, once) / self._lit(once)
        return exact, self._set or max(round(exact), 1)

    def _lit(self, schedule: Schedule) -> float:
        """Seconds of full drive per frame and turn, as rounded by the machines."""
        on = schedule.on if self.least is None else schedule.on // MICRO * MICRO
        return float(np.mean(on)) / SECOND * float(schedule.power[0, 0])

    def _dimmed(self, schedule: Schedule, lit: float) -> tuple[Schedule, float]:
        """Frames lit for a share of their time, or at a share of the drive, and that share."""
        if lit >= 1.0:
            return schedule, 1.0
        if self.least is None:
            return replace(schedule, power=schedule.power * lit), lit
        full = int(schedule.on[0])
        on = min(max(round(full * lit / MICRO) * MICRO, self.least), full)
        return replace(schedule, on=np.full_like(schedule.on, on), dark=schedule.light + on), on / full

    def _check(self, turns: int, once: Schedule, why: str) -> None:
        """Raise `BadInput` for more frames than a print may have."""
        if turns * once.frames > SLOTS:
            raise BadInput(f"{counted(turns, 'turn')} of {once.frames} frames{why}; expected at most {SLOTS} frames: "
                           "use fewer turns, or more light")  # fmt: skip

    def _off(self, dose: GivenDose, exact: float, once: Schedule) -> None:
        """Reject a dose outside the verdict, or warn if the user chose it."""
        turns = counted(dose.turns, "turn")
        takes = f"the exposure takes {counted(exact, 'turn', '.4g')} of {float(360 / once.speed):.4g} s"
        if dose.asked:
            warnings.warn(f"{turns} of light: the dose is {dose}; {takes}", DoseWarning, stacklevel=4)
            return
        power = self.light.power * exact / max(ceil(exact), dose.turns)
        remedy = f"dim the projector and set power = {power:.3g} in [light]"
        if exact > self._set > 0:
            remedy = f"use {exact / self._set:.3g} times the light, or more turns in [travel]"
        elif self.least is not None:
            remedy = f"frames cannot be shorter, so set power = {self.light.power / dose.share:.3g} in [light]"
        elif (fitting := self._fitting(dose.proved, self.speeds)) is not None:
            remedy = f"print with --speed {fitting:.6g}"
        raise BadInput(
            f"{takes}; with {turns} the dose is {dose}; expected {dose.proved.least:.3f} to "
            f"{dose.proved.most:.3f}: {remedy}"
        )
