"""Turns of a vial: as many as the proved exposure needs, dimmed to give the proved dose."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, DoseWarning, StorageError
from vamgpu.hosts.rigs.jobs import PrintJob
from vamgpu.hosts.rigs.roles import LightPart
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.jobs.run import Proven, prove
from vamgpu.printing.given_dose import GivenDose, ProvedDose, counted
from vamgpu.storage.folder import Folder

SLOTS = 10**7  # Most frames of a print; more are a typing error
CLOSE = 1e-3  # Share of a turn below which frames are not dimmed
MICRO = 1000  # Machines light frames for whole microseconds [ns]


def proved(jobs: tuple[PrintJob, ...], device: str | Device | None = None) -> Proven | str:
    """The proof of a vial's job, or why its exposure is not known. Raises as `prove` does."""
    path = jobs[0].path
    if len(jobs) > 1:
        return f"{len(jobs)} projectors share the dose, and each job is proved separately"
    inputs = Folder.open(path).manifest.inputs
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

    of: Callable[[int], Schedule]  # makes the schedule of a number of turns
    light: LightPart
    scale: float  # irradiance of a full-on pixel of the frames
    least: int | None  # shortest light of a frame [ns]; None on a video cable

    def schedule(self, turns: int | None, known: Callable[[], ProvedDose | str]) -> tuple[Schedule, GivenDose | None]:
        """Return the slots and their dose; BadInput for a dose outside the verdict that the user did not choose."""
        once = self.of(1)
        self._check(turns or 1, once, "")
        proved = known()
        if isinstance(proved, str):
            if turns is None:
                raise BadInput(f"{proved}, so its number of turns is not known; expected a number: "
                               "give --turns (turns= in Python), or solve the job with [print]")  # fmt: skip
            return self.of(turns), None
        full = self.light.irradiance or proved.irradiance
        need = proved.seconds * proved.irradiance / full * self.scale / proved.scale / once.frames
        exact = need / self._lit(once)
        lit = 1.0
        if turns is None:
            count = max(round(exact), 1)
            dims = self.least is not None or self.light.gate == "controller"
            if dims and abs(count / exact - 1.0) > CLOSE:
                count = max(ceil(exact), 1)
                lit = exact / count
        else:
            count = turns
        self._check(count, once, f": its exposure takes {proved.seconds:.3g} s of full light")
        found, lit = self._dimmed(self.of(count), lit)
        share = self._lit(found) * count / need
        dose = GivenDose(proved, share, count, found.duration / SECOND, lit, self.least is None, turns is not None)
        if not dose.keeps:
            self._off(dose, exact, once)
        return found, dose

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
            raise BadInput(f"{turns} turns of {once.frames} frames{why}; expected at most {SLOTS} frames: use fewer "
                           "turns, or more light")  # fmt: skip

    def _off(self, dose: GivenDose, exact: float, once: Schedule) -> None:
        """Reject a dose outside the verdict, or warn if the user chose it."""
        takes = f"the exposure takes {exact:.4g} turns of {float(360 / once.speed):.4g} s"
        if dose.asked:
            warnings.warn(f"{counted(dose.turns)} of light: the dose is {dose}; {takes}", DoseWarning, stacklevel=4)
            return
        remedy = f"turn at {float(once.speed) * dose.share:.4g} deg/s, to make turns whole"
        if self.least is not None:
            remedy = f"frames cannot be shorter, so lower power in [light] to {self.light.power / dose.share:.3g}"
        raise BadInput(
            f"{takes}; with {counted(dose.turns)} the dose is {dose}; expected ×{dose.proved.least:.3f} to "
            f"×{dose.proved.most:.3f}: {remedy}, or accept this dose with --turns {dose.turns} (turns= in Python)"
        )
