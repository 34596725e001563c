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
    """A print that a host left. first: the next slot.  unseen: from which one nobody saw all.  origin: see `Origin`.

    lost: poses that were black, of each projector.  since: when it had light last, by the clock of its days [s].
    """

    run: Run
    first: int
    unseen: int
    origin: Origin
    lost: tuple[tuple[int, ...], ...]
    since: float

    @property
    def rest(self) -> int:
        """How long it has been dark [ns]."""
        return _since(self.since)

    def take_up(self, folder: RunFolder, schedule: Schedule, now: int) -> None:
        """Write down, at a time of the rig's clock [ns], what was triggered after the host's last look.

        What was on show then may have been cut short, and so the last; mirrors that go dark with their program have
        shown none of what came after.
        """
        if self.first > self.unseen:
            folder.event("unseen", now, first=self.unseen, stop=self.first)
        have = set(zip(self.run.shown["slot"].tolist(), self.run.shown["engine"].tolist(), strict=True))
        for slot in range(self.unseen, self.first):
            frame, pose, light, on = (int(getattr(schedule, name)[slot]) for name in ("frame", "pose", "light", "on"))
            for engine in range(schedule.engines):
                if (slot, engine) in have:
                    continue
                folder.shown(Shown(slot, frame, pose, light, on, engine=engine))


@dataclass(frozen=True, eq=False)
class Left:
    """What the folder of a host that died tells by itself. leg: its last event of that kind.

    sign: when it wrote of light last [s].  dark: whether it had put the light out itself.
    """

    run: Run
    leg: dict[str, Any]
    sign: float
    dark: bool


def left_in(run: Run, limits: Limits = Limits()) -> Left:
    """What the folder of a host that died tells. Raises `BadInput` where its print cannot be gone on with."""
    path = run.path
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
    _rested(path, float(run.events[-1]["wall"]), limits)
    signs = [event for event in run.events if event["event"] in ("leg", "light", "look")]
    dark = next(event.get("to") == "off" for event in reversed(signs) if event["event"] != "look")
    return Left(run, leg, float(signs[-1]["wall"]), dark)


def _rested(path: str | Path, since: float, limits: Limits) -> None:
    """Raise `BadInput` for a rest since a time of these days [s] that was too long, or that nobody knows."""
    if (rest := _since(since)) < 0:
        raise BadInput(
            f"the last sign of {str(path)!r} is {-rest / SECOND:.1f} s ahead of this host's clock, so nobody knows how "
            "long it rested; begin anew with fresh resin"
        )
    may_resume(rest, limits)


def interrupted(path: str | Path, controller: Controller, schedule: Schedule, limits: Limits = Limits()) -> Interrupted:
    """What a print's folder and its controller tell together. Raises `BadInput` where it cannot be gone on with.

    The controller must have kept its power: it alone knows where the motor is, and what it showed until the lease of
    the host that died ran out.
    """
    left = left_in(read_run(path), limits)
    run, leg, now = left.run, left.leg, controller.status()
    if now.zero != leg.get("zero"):
        raise BadInput(
            f"the controller does not know the print of {str(path)!r}: it lost its power, was reset when its port was "
            "opened, or another print began, so nobody knows where the motor is; begin anew with fresh resin"
        )
    slots = run.shown["slot"]
    recorded = int(slots.max()) + 1 if len(slots) else 0
    shown = leg["first"] + _counted(now, leg)
    if now.play not in (leg["play"], leg["before"]) or shown < recorded:
        raise BadInput(
            f"another program let the controller play after {str(path)!r} was left, so nobody knows what the resin "
            "saw; begin anew with fresh resin"
        )
    dark = run.shown[run.shown["dark"] > 0]
    if shown >= len(schedule):
        missed = f", {len(dark)} of them black: only the host that planned them shows them again" if len(dark) else ""
        raise BadInput(f"{str(path)!r} has shown all its {len(schedule)} slots{missed}; nothing is left to print")
    lost = (dark["position"][dark["engine"] == engine].tolist() for engine in range(schedule.engines))
    origin = Origin(leg["origin"], leg["zero"])
    lit = recorded > leg["first"]  # what was shown after that counts as dark: a rest is rather told too long
    since = left.sign if lit else leg["wall"] - leg["dark"] / SECOND
    _rested(path, since, limits)
    return Interrupted(run, shown, recorded - int(lit and not left.dark), origin, tuple(map(tuple, lost)), since)


def _counted(now: Status, leg: dict[str, Any]) -> int:
    """Pictures of a leg that the controller showed; a host that died in between had not let it play yet."""
    return max(now.shown - leg["preroll"], 0) if now.play == leg["play"] else 0


def _since(wall: float) -> int:
    """Since a time of these days [ns]."""
    return round((time.time() - wall) * SECOND)
