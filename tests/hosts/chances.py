"""Hosts that die or stand still at any moment, on a program's clock: what they leave, and what resin saw of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_planning import vial, web

from vamgpu.errors import VamError
from vamgpu.hosts.emulators.screen import LitSlot
from vamgpu.hosts.records.account import LightAccount, account, wanted_light
from vamgpu.hosts.records.record import RunFolder, RunRecord, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import PrintPlan, Rehearsal, carry_out, check, plan, rehearsal
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.schedules.timing import SECOND

RIGS = Path(__file__).parents[2] / "docs" / "rigs"
NAMES = [path.stem for path in sorted(RIGS.glob("*.toml"))]
OFTEN = re.compile('\'(stat|row|lease|get pos)|"(look|poll)"|shown.bin|AlpProjInquire|show')
"""Acts that a host does over and over; the others are the rare ones."""
RIGHTLY = (
    "standby",
    "has shown nothing",
    "has shown all",
    "is complete",
    "paused",
    "triggered the mirrors",
    "cannot be",
)
"""Words of refusals to resume."""


class Died(BaseException):
    """The host is no more."""


class Life:
    """A host's: each of its acts on a machine or a file is a moment, counted from 1.

    death: the moment at which it dies.  after: whether it still does what it does then.  happens: what is done before
    the acts of some moments.
    """

    def __init__(
        self, death: int | None = None, after: bool = False, happens: dict[int, Callable[[], None]] | None = None
    ) -> None:
        self._death, self._after, self._happens = death, after, happens or {}
        self.moments: list[str] = []
        self.dead = False

    def mortal(self, owner: Any, *names: str) -> None:
        """These methods are acts of the host; none of them does anything once it is dead."""
        for name in names:
            setattr(owner, name, self._mortal(name, getattr(owner, name)))

    def _mortal(self, name: str, act: Callable[..., Any]) -> Callable[..., Any]:
        def acts(*arguments: Any, **named: Any) -> Any:
            if self.dead:
                raise Died
            self.moments.append(f"{name} {arguments}" if name != "show" else name)
            now = len(self.moments)
            self._happens.get(now, lambda: None)()
            self.dead = now == self._death
            if self.dead and not self._after:
                raise Died
            answer = act(*arguments, **named)
            if self.dead:
                raise Died
            return answer

        return acts

    def rare(self) -> list[int]:
        """Moments of acts that are not done over and over."""
        return [moment for moment, act in enumerate(self.moments, 1) if not OFTEN.search(act)]


def on_its_days(patch: pytest.MonkeyPatch, clock: Any, changed: Callable[[], float] = lambda: 0.0) -> None:
    """The time of day is that of a rig's clock, changed by so many seconds."""
    days = SimpleNamespace(time=lambda: 1e9 + changed() + clock.now() * 1e-9)
    for module in ("process.resume", "records.record"):
        patch.setattr(f"vamgpu.hosts.{module}.time", days)


def levels_of(planned: PrintPlan) -> np.ndarray:
    """The frames of a plan, full on at 1, (frames, rows, columns)."""
    source: Any = planned.sources()[0]
    return source.levels(np.arange(planned.schedule.frames)).astype(float) / 255


def light_of(planned: PrintPlan, recorder: Any) -> np.ndarray:
    """Light of each frame that fell while the motion was in its pose, from mirrors [ns], (frames,)."""
    levels, count = levels_of(planned), planned.schedule.frames
    planes = max(1, len(planned.jobs[0].depths))
    light = recorder.seconds(0, count // planes, turn=count if planned.kind == "vial" else None)
    down, across = planned.mirrors[0].place(*levels.shape[1:])
    light = light.transpose(1, 0, 2, 3).reshape(count, *light.shape[2:])[:, down, across]
    return light.sum(axis=(1, 2)) / levels.sum(axis=(1, 2)) * 1e9


class RigStand:
    """A small print on a rig file of docs/rigs, rehearsed; one host after the other prints it.

    last: when light fell last [ns].  seen: of a video cable, frame, pose at the middle, and duration [ns] of each slot
    that was lit.
    """

    def __init__(self, name: str, place: Path) -> None:
        self.name, self.run = name, place / "run"
        job = web(place / "job.vam", poses=24) if name == "roll_bench" else vial(place / "job.vam", images=60)
        speed = 0.8 if name == "roll_bench" else None
        self.planned: PrintPlan = plan(job, read_rig(RIGS / f"{name}.toml"), rehearsed=True, speed=speed, turns=1)
        self.stand: Rehearsal = rehearsal(self.planned)
        self.emulated: Any = self.stand.emulated
        self.clock = self.emulated.clock
        self.clock.detach(self.stand.monitor)  # which forgets what it compared
        self.leased = next(one.holds for one in self.planned.guarantees if one.about == "lease")
        self.found = check(self.planned, self.stand.machines)
        self.mirrors = not hasattr(self.stand.machines, "projector")
        table = self.planned.schedule
        held = 0 if self.found is None else self.found.depth * self.found.sequences
        self.ahead = round(held * float(table.cadence.period))  # for so long the mirrors have frames [ns]
        self.last = 0
        self.time_change = 0.0  # of the time of day [s]
        self.seen: list[tuple[int, float, int]] = []
        if self.planned.display is not None:
            self._look_at_the_screen()
        else:
            self.emulated.recorder.listeners.append(lambda _, begin, stop: setattr(self, "last", stop))

    def _look_at_the_screen(self) -> None:
        levels = np.rint(levels_of(self.planned) * 255).astype(np.uint8)
        frames = {frame.tobytes(): number for number, frame in enumerate(levels)}
        down, across = self.planned.mirrors[0].place(*levels.shape[1:])
        integrate = self.emulated.screen.on_slot

        def slot(slot: LitSlot) -> None:
            integrate(slot)
            if slot.levels.any():
                number = frames[np.ascontiguousarray(slot.levels[down, across]).tobytes()]
                where = self.emulated.recorder._position((slot.start + slot.end) // 2)
                self.seen.append((number, where, slot.end - slot.start))
                self.last = slot.end

        self.emulated.screen.on_slot = slot

    def hosts(self, life: Life, unattended: int = 0, **options: Any) -> PrintState | None:
        """Print, or go on with the print that is there; None where the host died. options: of `carry_out`."""
        again = self.run.exists()
        machines: Any = self.stand.machines
        if again and self.mirrors:
            machines = self.emulated.machines(machines.microsteps)
        with pytest.MonkeyPatch.context() as patch, self._living(life, machines, patch):
            options |= {"found": self.found, "resume": again, "unattended": unattended}
            state = carry_out(self.planned, machines, self.run, **options)[0]
            return None if life.dead else state
        return None

    @contextmanager
    def _living(self, life: Life, machines: Any, patch: pytest.MonkeyPatch) -> Iterator[None]:
        """All that a host does is mortal."""
        on_its_days(patch, self.clock, lambda: self.time_change)
        acts = [(getattr(machines, name, None), "ask") for name in ("controller", "stage")]
        acts += [(getattr(machines, "stage", None), "_set"), (getattr(machines, "lamp", None), "_set")]
        acts += [(getattr(machines, "projector", None), name) for name in ("show", "black")]
        acts += [(dmd, "call") for dmd in getattr(machines, "mirrors", ())]
        acts += [(RunFolder, name) for name in ("_put", "state")]
        for owner, name in acts:
            if owner is not None and hasattr(owner, name):
                patch.setattr(owner, name, life._mortal(name, getattr(owner, name)))
        try:
            yield
        except BaseException:
            if not life.dead:
                raise

    def abandoned(self, at_once: bool) -> None:
        """The host has died: its mirrors go dark, at once or in a second."""
        alps = getattr(self.emulated, "alps", ())
        for pause in (0, SECOND) if at_once else (SECOND,):
            self.clock.sleep(pause)
            for alp in alps:
                alp.disconnect()

    def shines(self) -> bool:
        """Whether light falls within the next second, after the refresh that a screen was showing."""
        shown = round(float(self.planned.schedule.cadence.period)) + 1000 if self.planned.display is not None else 0
        now = self.clock.now() + shown
        self.clock.sleep(SECOND)
        return self.last > now

    def got(self) -> np.ndarray:
        """Light of each frame that the resin got, wherever the motion was [ns], (frames,)."""
        count = self.planned.schedule.frames
        if self.planned.display is not None:
            found = np.zeros(count)
            for number, _, took in self.seen:
                found[number] += took
            return found
        drive = self.planned.rig.setup.light.power if self.planned.rig.setup.light.gate == "controller" else 1.0
        return light_of(self.planned, self.emulated.recorder) / drive

    def told(self) -> tuple[RunRecord, LightAccount]:
        """The record, and its account of the light."""
        record = read_run(self.run)
        found = account(record, wanted_light(self.planned.schedule))
        assert found is not None
        return record, found

    def told_by_itself(self) -> tuple[RunRecord, LightAccount]:
        """The record, and its account of the light by what is in the folder alone."""
        record = read_run(self.run)
        found = account(record)
        assert found is not None
        return record, found

    def is_as_told(self, found: LightAccount, last: np.ndarray | None = None) -> None:
        """Nothing that mirrors show is lit twice, and the resin got what the record says.

        last: frame on show when the host died, of a print that ends there: nobody was left to tell what became of it,
        nor of those that it had handed on.
        """
        got, (wanted,), (sure,), (unsure,) = self.got(), found.wanted, found.sure, found.unsure
        slack = 0.004 * wanted + 1e6
        if self.mirrors:
            assert (got <= wanted + slack).all(), "nothing is lit twice"
        missing = np.flatnonzero(got < sure - slack)
        assert np.isin(missing, [] if last is None else last).all(), "what is missing is told"
        if last is None:
            assert (got <= sure + unsure + slack).all(), "light that was given is told"


@cache
def acts(name: str) -> tuple[int, tuple[int, ...]]:
    """How many moments the life of a host has that prints on a rig undisturbed, and which are rare."""
    with TemporaryDirectory() as place:
        stand, life = RigStand(name, Path(place)), Life()
        assert stand.hosts(life) is PrintState.COMPLETE
    return len(life.moments), tuple(life.rare())


def ended(stand: RigStand, life: Life, unattended: int) -> PrintState:
    """The state at the end of a print that some error may end."""
    try:
        state = stand.hosts(life, unattended)
        assert state is not None
        return state
    except VamError:
        return read_run(stand.run).state
