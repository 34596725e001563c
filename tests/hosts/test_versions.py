"""Frames that are replaced while they are printed: at the boundary of a turn, on all projectors, or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from doubles import MODEL, STEPS, Replaced, late
from test_stage_mirrors import RIG

from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.emulators.clock import PacedClock
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.frames.versions import Boundaries, FrameVersion, FrameVersions
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.run import Print, SafetyLimits
from vamgpu.hosts.player.video import SpinningPlayer
from vamgpu.hosts.process.versions import sources_of
from vamgpu.hosts.records.account import account
from vamgpu.hosts.records.plans import keep
from vamgpu.hosts.records.proof import shown_frames
from vamgpu.hosts.records.record import FrameRecord, RunFolder, RunRecord, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import PrintPlan, carry_out, plan, read_rig
from vamgpu.hosts.rigs.config import RigConfig, parse_rig
from vamgpu.hosts.safety.interlock import Budget
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.printing.frames import Frames

COUNT = 40
SCREEN = """
[rig]
name = "screen"
machine = "vial"
[motion]
driver = "zaber"
port = "/dev/ttyUSB0"
microsteps = 1000
encoder = true
[display]
driver = "video"
screen = 1
size = [6, 10]
refresh = "60 Hz"
[controller]
port = "/dev/ttyACM0"
"""
MIRRORS = MirrorTiming(pixels=(16, 2), row_bytes=2, dark=2e-3)


class Column:
    """Frames of which one column is full on."""

    bits = 8

    def __init__(self, column: int) -> None:
        self.column, self.made = column, 0

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        assert 0 <= numbers.min() <= numbers.max() < COUNT
        self.made += len(numbers)
        return np.stack([np.packbits(np.tile(self.frame(0) > 0, (8, 1, 1)), axis=-1)] * len(numbers))

    def frame(self, number: int) -> np.ndarray:
        return np.where(np.arange(16) == self.column, 255, 0).astype(np.uint8)[None].repeat(2, axis=0)


class Vial:
    """A print of a vial on triggered mirrors, whose frames may be replaced; column ``v`` is that of version ``v``."""

    def __init__(
        self, path: Path, turns: int = 4, *, depth: int = 8, engines: int = 1, allowance: float = 0.0,
        resident: int | None = None, paced: bool = False,
    ) -> None:  # fmt: skip
        self.path, self.turns, self.engines = path, turns, engines
        timings = (MIRRORS,) * engines if engines > 1 else MIRRORS
        self.schedule = turned(COUNT, speed=240 if paced else 40, engines=timings, turns=turns)
        self.emulated = EmulatedMirrorRig(STEPS, MODEL, engines, clock=PacedClock() if paced else None)
        self.versions = FrameVersions([Column(0)] * engines, COUNT, turns, allowance=allowance)
        self.player = TriggeredPlayer(
            self.schedule, self.emulated.machines(STEPS / float(self.schedule.advance)), [Column(0)] * engines,
            depth=depth, versions=self.versions, sequences=resident or 2, turn=COUNT if resident else None,
        )  # fmt: skip
        limits = SafetyLimits(lease=SECOND)  # a busy machine
        self.print = Print(self.player, RunFolder.begin(path, {}, ""), limits=limits)
        self.happens: dict[int, Callable[[], object]] = {}

    def swap(self, turn: int, **options: float | int | None) -> int:
        number = self.versions.last + 1
        return self.versions.swap([Column(number)] * self.engines, turn, **options)  # type: ignore[arg-type]

    def at(self, slot: int, act: Callable[[], object]) -> None:
        """Do something once a slot is about to be shown."""
        self.happens[slot] = act

    def watched(self) -> None:
        """Let what is to happen do so at its slot."""
        wait = self.player.wait

        def waited() -> None:
            for slot in [slot for slot in self.happens if slot <= self.print.next]:
                self.happens.pop(slot)()
            wait()

        self.player.wait = waited  # type: ignore[method-assign]

    def run(self) -> RunRecord:
        self.watched()
        try:
            self.print.run()
        finally:
            self.print.folder.close()
        return read_run(self.path)

    def columns(self, engine: int = 0) -> np.ndarray:
        """How long light fell [slots], by column and turn."""
        light = self.emulated.recorder.seconds(engine, len(self.player.schedule))[0, :, 0]
        by_turn = light.reshape(-1, COUNT, 16).sum(axis=1).T
        return np.round(by_turn / (1e-9 * int(self.schedule.on[0])), 2)


def events(run: RunRecord, kind: str) -> list[dict[str, object]]:
    return [event for event in run.events if event["event"] == kind]


def test_a_version_is_shown_from_the_beginning_of_its_turn(run: Path) -> None:
    vial = Vial(run)
    vial.at(5, lambda: vial.swap(1))
    vial.at(50, lambda: vial.swap(3))
    told = vial.run()
    assert told.state is PrintState.COMPLETE
    assert told.shown["version"].tolist() == [0] * 40 + [1] * 80 + [2] * 40
    assert told.shown["frame"].tolist() == [*range(40)] * 4
    wanted = np.zeros((16, 4))
    wanted[0, 0] = wanted[1, 1] = wanted[1, 2] = wanted[2, 3] = COUNT
    assert np.array_equal(vial.columns(), wanted), "what the resin saw"
    assert [(each["version"], each["turn"]) for each in events(told, "swap")] == [(1, 1), (2, 3)]
    assert vial.print.board.now.plan == 2 and not told.shown["dark"].any() and told.shown["late"].max() < 0


@pytest.mark.parametrize("depth", [4, 8, 13, 40])
def test_a_swap_comes_in_time_until_its_lead_and_is_dropped_after(run: Path, depth: int) -> None:
    vial = Vial(run, turns=3, depth=depth)
    boundaries = vial.player._boundaries(2)
    assert boundaries is not None and boundaries.lead == 2 + depth
    last = COUNT - 1 - min(boundaries.lead, COUNT - 1)
    vial.at(max(last - 2, 0), lambda: vial.swap(1))
    vial.at(COUNT + last + 3, lambda: vial.swap(2))
    told = vial.run()
    if depth < COUNT:
        assert told.shown["version"].tolist() == [0] * COUNT + [1] * 2 * COUNT
        assert [each["version"] for each in events(told, "swap dropped")] == [2]
        assert "turn 2 were already queued" in str(events(told, "swap dropped")[0]["why"])
    assert not told.shown["dark"].any() and told.state is PrintState.COMPLETE
    seen = vial.columns()
    assert all((seen[:, turn] == COUNT).sum() == 1 and seen[:, turn].sum() == COUNT for turn in range(3)), "whole turns"


@pytest.mark.slow
def test_threads_pack_no_frame_of_a_turn_that_may_be_replaced(run: Path) -> None:
    vial = Vial(run, turns=3, paced=True)
    for turn in (1, 2):
        vial.at(COUNT * turn - 38, lambda turn=turn: vial.swap(turn))
    told = vial.run()
    assert vial.player._threaded
    dropped = {each["version"] for each in events(told, "swap dropped")}  # where the machine was too busy
    shown = 0
    for turn in range(3):
        shown = turn if turn and turn not in dropped else shown
        lit = told.shown[(told.shown["slot"] // COUNT == turn) & (told.shown["frame"] >= 0)]
        assert set(lit["version"].tolist()) == {shown}, "one version a turn"


def test_all_projectors_swap_or_none(run: Path) -> None:
    vial = Vial(run, turns=3, engines=2)
    vial.at(3, lambda: vial.swap(1))
    # one queue has packed more than the other: neither is swapped
    vial.at(45, lambda: (setattr(vial.player._queues[1], "_taken", 2 + 81), vial.swap(2)))
    told = vial.run()
    for engine in (0, 1):
        assert np.flatnonzero(vial.columns(engine)[1]).tolist() == [1, 2] and not vial.columns(engine)[2].any()
    assert [each["version"] for each in events(told, "swap dropped")] == [2]


def test_a_newer_offer_takes_the_place_of_one_that_waits_or_was_committed(run: Path) -> None:
    vial = Vial(run)
    vial.at(3, lambda: (vial.swap(2), vial.swap(2)))
    vial.at(10, lambda: vial.swap(1))  # sooner than what is committed: its turns too
    told = vial.run()
    assert told.shown["version"].tolist() == [0] * 40 + [3] * 120
    assert [(each["version"], each["why"]) for each in events(told, "swap dropped")] == [
        (1, "version 2 came before it was shown")
    ]


def test_a_turn_that_does_not_change_is_not_uploaded_again(run: Path) -> None:
    vial = Vial(run, turns=6, depth=10, resident=6)
    sources = [Column(0)]
    vial.versions._versions[0] = FrameVersion(0, tuple(sources), 0)
    new = Column(1)
    vial.at(90, lambda: vial.versions.swap([new], 3))
    told = vial.run()
    assert told.shown["version"].tolist() == [0] * 120 + [1] * 120
    assert (sources[0].made, new.made) == (COUNT, COUNT), "each version went to the mirrors once"
    assert vial.columns()[:2].tolist() == [[COUNT] * 3 + [0] * 3, [0] * 3 + [COUNT] * 3]


def test_what_was_missed_is_shown_again_in_its_own_version(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late(monkeypatch, {10, 52})
    vial = Vial(run, turns=2, depth=2)
    vial.at(5, lambda: vial.swap(1))
    told = vial.run()
    assert told.state is PrintState.COMPLETE
    shown = told.shown[(told.shown["slot"] >= 80) & (told.shown["frame"] >= 0)]
    assert [(int(each["frame"]), int(each["version"])) for each in shown] == [(10, 0), (12, 1)]
    light = vial.emulated.recorder.seconds(0, COUNT, turn=COUNT)[0, :, 0, :2].T
    assert np.abs(light / light[0, 0] - 1).max() < 1e-3, "each version gave each view its light once"


def test_a_pause_keeps_versions_and_takes_those_that_came_in_it(run: Path) -> None:
    vial = Vial(run, turns=3)
    vial.at(10, lambda: vial.swap(1))
    vial.at(60, vial.print.pause)
    vial.watched()
    assert vial.print.run() is PrintState.PAUSED
    vial.swap(2)
    assert vial.print.run() is PrintState.COMPLETE
    vial.print.folder.close()
    assert read_run(run).shown["version"].tolist() == [0] * 40 + [1] * 40 + [2] * 40


def test_a_version_may_end_the_print_sooner(run: Path) -> None:
    vial = Vial(run, turns=5)
    vial.at(10, lambda: vial.swap(1, stop=3))
    told = vial.run()
    lit = told.shown[told.shown["frame"] >= 0]
    assert lit["slot"].max() == 3 * COUNT - 1 and told.state is PrintState.COMPLETE and "after 3 turns" in told.message
    assert vial.columns()[0, 0] == vial.columns()[1, 1] == vial.columns()[1, 2] == COUNT, "whole turns"
    assert vial.columns()[:, 3:].sum() == 0 and vial.print.board.now.stop == 3
    budget = vial.print.guard.budget
    assert budget is not None and budget.limit == pytest.approx(1.01 * budget.spent)


def test_a_budget_is_armed_anew_and_never_over_the_first(run: Path) -> None:
    vial = Vial(run, turns=5)
    budget = vial.print.guard.budget
    assert budget is not None
    most = budget.limit
    found = []
    vial.at(10, lambda: vial.swap(1, stop=3))
    vial.at(15, lambda: (found.append(budget.limit), vial.swap(2)))
    vial.run()
    assert found == [pytest.approx(0.6 * most)] and budget.limit == pytest.approx(most)
    budget.arm(10 * most)
    assert budget.limit == most
    with pytest.raises(BadInput):
        Budget(1.0).arm(float("nan"))


def test_versions_add_no_more_light_than_was_allowed(run: Path) -> None:
    vial = Vial(run, turns=4, allowance=0.1)
    with pytest.raises(BadInput, match="4.6 times the light of a turn; 4.4 are allowed"):
        vial.swap(1, light=1.2)
    vial.swap(2, light=1.2)
    for light in (float("nan"), -1.0, float("inf")):
        with pytest.raises(BadInput, match="light of a version"):
            vial.swap(1, light=light)
    with pytest.raises(BadInput, match="turns 4 to None of 4"):
        vial.swap(4)
    with pytest.raises(BadInput, match="turns 2 to 2 of 4"):
        vial.swap(2, stop=2)
    with pytest.raises(BadInput, match="one for each projector"):
        vial.versions.swap([Column(1)] * 2, 1)
    with pytest.raises(BadInput, match="after version 1"):
        vial.swap(2, number=1)


def test_frames_of_versions_that_are_over_are_let_go(run: Path) -> None:
    vial = Vial(run, turns=6)
    for turn in range(1, 6):
        vial.at(40 * turn - 35, lambda turn=turn: vial.swap(turn))
    vial.run()
    assert sorted(vial.versions._versions) == [0, 5]


@pytest.mark.parametrize("slot", [0, 3, 30, 37, 39, 40])
def test_a_horizon_is_the_next_boundary_until_the_lead(slot: int) -> None:
    assert Boundaries(40, 0, 3).horizon(slot) == (80 if slot >= 37 else 40)
    assert Boundaries(40, 50, 3).horizon(slot) == 80, "nothing before the first slot counts"


def test_records_of_an_earlier_format_are_refused(run: Path) -> None:
    with RunFolder.begin(run, {}, "") as folder:
        folder.shown(FrameRecord(7, 3, 7, 100, 200))
    path = run / "shown.bin"
    path.write_bytes(path.read_bytes().replace(b"VAMSHOWN\x02", b"VAMSHOWN\x01"))
    with pytest.raises(StorageError, match="version 0.2 or earlier"):
        read_run(run)


# ---- other players, resuming, and what is proved afterwards ---------------------------------------------------------
def shades(planned: PrintPlan, *levels: int) -> list[Frames]:
    """Frames of one level each, like those of a plan."""
    job = planned.jobs[0].frames
    assert job is not None
    return [replace(job, images=job.device.upload(np.full(job.shape, level, np.uint8), table=True)) for level in levels]


class Planned(Replaced):
    """A rehearsal of a job on a rig whose frames are replaced by a shade from turn 1 on, and by another from turn 2."""

    def __init__(self, job: Path, run: Path, rig: RigConfig, turns: int = 3) -> None:
        super().__init__(run, plan(job, rig, turns=turns, rehearsed=True))

    def swap(self, level: int, turn: int, **options: Any) -> None:
        frames = shades(self.planned, level)
        number = self.versions.swap(sources_of(frames, self.planned.mirrors), turn, **options)
        keep(self.path, number, frames, {})

    def levels(self) -> np.ndarray:
        """What the resin saw of each view, in levels, summed over the turns."""
        on = 1e-9 * int(self.planned.schedule.on[0])
        down, across = self.planned.mirrors[0].place(6, 10)
        light = self.stand.emulated.recorder.seconds(0, 36, turn=36)[0]
        return light[:, down, across] * 255 / on


@pytest.mark.parametrize("rig", ["stage", "video"])
def test_stages_and_screens_show_a_version_from_its_turn_on(job: Path, run: Path, rig: str) -> None:
    made = Planned(job, run, parse_rig(RIG if rig == "stage" else SCREEN))
    made.happens = {5: lambda: made.swap(40, 1), 38: lambda: made.swap(90, 2)}
    told = made.run()
    assert told.state is PrintState.COMPLETE, told.message
    assert told.shown["version"].tolist() == [0] * 36 + [1] * 36 + [2] * 36
    frames = made.planned.jobs[0].frames
    assert frames is not None
    assert np.allclose(made.levels(), frames.levels() + 130.0, rtol=0.02), "each view once of each version"


def test_a_swap_in_the_midst_of_its_turn_comes_too_late_for_a_screen(job: Path, run: Path) -> None:
    made = Planned(job, run, parse_rig(SCREEN))
    made.happens = {37: lambda: made.swap(40, 1), 71: lambda: made.swap(90, 2)}
    told = made.run()
    assert [(each["event"], each["version"]) for each in told.events if "swap" in each["event"]] == [
        ("swap dropped", 1), ("swap", 2),
    ]  # fmt: skip
    assert told.shown["version"].tolist() == [0] * 72 + [2] * 36


def test_frames_that_are_sent_to_a_screen_are_not_replaced(job: Path, run: Path) -> None:
    made = Planned(job, run, parse_rig(SCREEN))
    offered: list[int] = []

    def feed() -> None:
        SpinningPlayer.feed(made.play)
        if not offered and made.play._sent >= 36 * made.play._repeats:
            assert made.play._kept < 36, "the resin has not seen them yet"
            offered.append(made.play._kept)
            made.swap(40, 1)

    made.play.feed = feed
    told = made.run()
    assert offered and not told.shown["version"].any()
    assert [event["version"] for event in told.events if event["event"] == "swap dropped"] == [1]


def test_light_is_counted_and_proved_by_version(job: Path, run: Path) -> None:
    made = Planned(job, run, read_rig("emulated"))
    made.happens = {5: lambda: made.swap(40, 1, stop=2)}
    told = made.run()
    light = account(told)
    assert light is not None and light.complete and set(light.versions) == {0, 1}
    on = int(made.planned.schedule.on[0])
    for number in (0, 1):
        each = light.versions[number]
        assert (each.wanted == on).all() and (each.sure == on).all() and not each.unsure.any()
    # a frame of version 1 that was never shown is missed, and the job's, shown twice, is too bright
    twice = told.shown.copy()
    twice["version"][twice["frame"] == 7] = 0
    missed = account(replace(told, shown=twice))
    assert missed is not None and np.flatnonzero(missed.short[0]).tolist() == [7]
    assert missed.facts()["versions"]["1"]["short"] == 1 and not missed.facts()["versions"]["0"]["short"]
    assert np.flatnonzero(missed.versions[0].excess[0]).tolist() == [7] and not missed.versions[1].excess.any()
    assert "1 may be overexposed: the brightest by 100 %" in str(missed.versions[0])
    frames = made.planned.jobs[0].frames
    assert frames is not None
    proof: Any = SimpleNamespace(frames=frames)
    shown = shown_frames(told, light, proof).irradiance(frames.device).numpy()
    wanted = (frames.irradiance().numpy() + shades(made.planned, 40)[0].irradiance().numpy()) / 3
    assert np.allclose(shown, wanted, atol=1e-6), "over the three turns of the plan"


def test_another_host_goes_on_with_the_version_that_was_committed(job: Path, run: Path) -> None:
    made = Planned(job, run, read_rig("emulated"))
    died = RuntimeError("the host is gone")

    def dies() -> None:
        made.print.guard._release_process()
        raise died

    made.happens = {5: lambda: made.swap(40, 1), 40: lambda: made.swap(90, 2), 50: dies}
    made.play.halt = made.play.doubtful = lambda: range(0)
    state = RunFolder.state
    RunFolder.state = lambda self, change: None if change.after.ended else state(self, change)  # type: ignore[method-assign]
    try:
        with pytest.raises(RuntimeError, match="is gone"):
            made.run()
    finally:
        RunFolder.state = state  # type: ignore[method-assign]
    keep(run, 3, shades(made.planned, 7), {})  # one that was not committed any more
    made.stand.emulated.clock.sleep(SECOND)
    made.stand.emulated.alps[0].disconnect()
    machines = made.stand.emulated.machines(made.stand.machines.microsteps)  # type: ignore[union-attr]
    state_, job_ = carry_out(made.planned, machines, run, resume=True)
    shown = read_run(run).shown
    assert state_.ended and shown["slot"].tolist() == [*range(108)]
    assert shown["version"].tolist() == [0] * 36 + [1] * 36 + [2] * 36
    frames = made.planned.jobs[0].frames
    assert frames is not None
    off = np.abs(made.levels() - frames.levels() - 130.0).max(axis=(1, 2))
    assert np.count_nonzero(off > 3) <= 1, "all but the frame that the lease cut"
    assert job_.player.versions is not None and job_.player.versions.last == 3, "no number comes twice"
