"""Going on with the print of a host that died: from its folder, and from what the controller says it still showed."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.players.approach import Origin
from vamgpu.hosts.protocols.controller import Status
from vamgpu.hosts.record import Run, RunFolder, Shown, read_run
from vamgpu.hosts.run import Limits, may_resume
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.hosts.state import State


@dataclass(frozen=True, eq=False)
class Interrupted:
    """A print that a host left. first: the next slot.  recorded: slots in its folder.  origin: see `Origin`.

    lost: poses that were black, of each projector.  sign: when it gave its last sign, by the clock of its days [s].
    """

    run: Run
    first: int
    recorded: int
    origin: Origin
    lost: tuple[tuple[int, ...], ...]
    sign: float

    @property
    def rest(self) -> int:
        """Since its last sign [ns]."""
        return round((time.time() - self.sign) * SECOND)

    def take_up(self, folder: RunFolder, schedule: Schedule) -> None:
        """Write down what was shown after the host's last look; the last of it may have been cut short."""
        have = set(zip(self.run.shown["slot"].tolist(), self.run.shown["engine"].tolist(), strict=True))
        for slot in range(max(self.recorded - 1, 0), self.first):
            row = (int(getattr(schedule, name)[slot]) for name in ("frame", "pose", "light", "on"))
            frame, pose, light, on = row
            for engine in range(schedule.engines):
                if (slot, engine) in have:
                    continue
                folder.shown(Shown(slot, frame, pose, light, on, engine=engine))


@dataclass(frozen=True, eq=False)
class Left:
    """What the folder of a host that died tells by itself. leg: the last one's event.  sign: see `Interrupted`."""

    run: Run
    leg: dict[str, Any]
    sign: float


def left_in(path: str | Path, limits: Limits = Limits()) -> Left:
    """Read the folder of a host that died. Raises `BadInput` where its print cannot be gone on with."""
    run = read_run(path)
    if run.state not in (State.PRINTING, State.PAUSED):
        raise BadInput(f"{str(path)!r} is {run.state.value}; only prints that a host left in the midst go on")
    leg = next((event for event in reversed(run.events) if event["event"] == "leg"), None)
    if leg is None:
        raise BadInput(f"{str(path)!r} has shown nothing; begin it anew in another folder")
    if "preroll" not in leg:
        raise BadInput(
            f"{str(path)!r} was printed on a screen: nobody knows what that showed until the light went off; begin "
            "anew with fresh resin"
        )
    sign = float(run.events[-1]["wall"])
    rest = round((time.time() - sign) * SECOND)
    if rest < 0:
        raise BadInput(
            f"the last sign of {str(path)!r} is {-rest / SECOND:.1f} s ahead of this host's clock, so nobody knows how "
            "long it rested; begin anew with fresh resin"
        )
    may_resume(rest, limits)
    return Left(run, leg, sign)


def interrupted(path: str | Path, controller: Controller, schedule: Schedule, limits: Limits = Limits()) -> Interrupted:
    """What a print's folder and its controller tell together. Raises `BadInput` where it cannot be gone on with.

    The controller must have kept its power: it alone knows where the motor is, and what it showed until the lease of
    the host that died ran out.
    """
    left = left_in(path, limits)
    run, leg, before = left.run, left.leg, controller.before
    if before.zero != leg.get("zero"):
        raise BadInput(
            f"the controller does not know the print of {str(path)!r}: it lost its power, was reset when its port was "
            "opened, or another print began, so nobody knows where the motor is; begin anew with fresh resin"
        )
    slots = run.shown["slot"]
    recorded = int(slots.max()) + 1 if len(slots) else 0
    shown = leg["first"] + _counted(before, leg["first"], recorded, leg["preroll"])
    if shown < recorded:
        raise BadInput(
            f"the folder holds {recorded} pictures, the controller counts {shown}: another program let it play, so "
            "nobody knows what the resin saw; begin anew with fresh resin"
        )
    dark = run.shown[run.shown["dark"] > 0]
    if shown >= len(schedule):
        missed = f", {len(dark)} of them black: only the host that planned them shows them again" if len(dark) else ""
        raise BadInput(f"{str(path)!r} has shown all its {len(schedule)} slots{missed}; nothing is left to print")
    lost = (dark["position"][dark["engine"] == engine].tolist() for engine in range(schedule.engines))
    origin = Origin(leg["origin"], leg["zero"])
    return Interrupted(run, shown, recorded, origin, tuple(map(tuple, lost)), left.sign)


def _counted(before: Status, first: int, recorded: int, preroll: int) -> int:
    """Pictures of a leg from a slot on that the controller showed.

    Its rows begin anew with each leg, its count only once they are played: a host that died in between left the count
    of the leg before.
    """
    waits = before.row < before.shown and recorded <= first
    return 0 if waits else max(before.shown - preroll, 0)
