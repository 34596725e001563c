"""Webs whose frames are replaced while they are printed: where a segment begins, or not at all."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doubles import Replaced
from test_live_faults import answered, kinds
from test_planning import BEAM, MASKS, ROLLER
from test_stage_mirrors import RIG
from web_workers import WEAK, bars

from vamgpu.errors import BadInput
from vamgpu.hosts.frames.sources import WebFrames
from vamgpu.hosts.frames.versions import Boundaries, FrameVersions
from vamgpu.hosts.player.player import StatusPoll
from vamgpu.hosts.process.live_link import LiveLink, LiveOrder, task_of
from vamgpu.hosts.process.versions import boundary, planned_versions, replaced, sources_of
from vamgpu.hosts.records.account import account
from vamgpu.hosts.records.plans import keep, kept_frames, last_kept
from vamgpu.hosts.records.record import RunFolder, RunRecord, read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rig import carry_out, check, plan, read_rig, rehearsal
from vamgpu.hosts.rigs.config import RigConfig, parse_rig
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.printing.focus import FocusMasks
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.webs.describe import described, described_focus
from vamgpu.webs.proof import prove_web
from vamgpu.webs.store import WebFolder

POSES, SEGMENT = 130, 30
"""The last of five segments is shorter."""


def web(path: Path, masks: FocusMasks | None = MASKS, seed: int = 6, segment: int = SEGMENT) -> Path:
    """A web of five segments, whose frames are of chance, at most half on."""
    columns, rows = BEAM.pixels
    details = {
        "grid": {"section": [4, 6], "pitch": [ROLLER.advance, 0.25, 0.25]},
        "beam": {"pixels": [columns, rows], "pitch": BEAM.pitch}, "wrap": described(ROLLER), "speed": 0.8,
        "frames": {"bits": 8, "gray": GrayCurve.linear().describe(), "scale": 1.0, "focus": described_focus(masks)},
    }  # fmt: skip
    folder = WebFolder.create(path, details, (rows, columns), (4, 6), (segment, 4))
    images = np.random.default_rng(seed).integers(0, 128, (POSES, rows, columns), dtype=np.uint8)
    for first in range(0, POSES, segment):
        part = images[first : first + segment]
        target = np.full((4, 4, 6), 255, np.uint8)
        folder = folder.append(part, target, (1.0, 0.5), 0, first + segment >= POSES)
    return folder.path


class Rolled(Replaced):
    """A rehearsal of webs whose frames from a segment on are replaced by those of a level, and up to six more."""

    def __init__(
        self, path: Path, engines: int = 1, rig: RigConfig | None = None, masks: FocusMasks | None = MASKS,
        allowance: float = 10.0,
    ) -> None:  # fmt: skip
        jobs = [web(path / f"web{k}.vam", masks, 6 + k) for k in range(engines)]
        super().__init__(path / "run", plan(jobs, rig or read_rig("emulated"), rehearsed=True, turns=1), allowance)
        self.planes = 1 if masks is None else 3
        self.expected = [each.stretch(0, POSES).levels().copy() for each in self.planned.jobs if each.stretch]

    def frames(self, level: int, turn: int, segments: int) -> list[Frames]:
        stop = min((turn + segments) * SEGMENT, POSES)
        jobs, self.until = replaced(self.planned, turn, stop - turn * SEGMENT)
        images = [np.full(each.shape, level, np.uint8) + np.arange(each.shape[0], dtype=np.uint8)[:, None, None] % 7
                  for each in jobs]  # fmt: skip
        return [
            Frames.from_bytes(image, "numpy", bits=8, gray=each.gray, scale=1.0, columns=each.columns)
            for image, each in zip(images, jobs, strict=True)
        ]

    def swap(self, level: int, turn: int, segments: int = 9, *, shown: bool = True, **options: Any) -> int:
        frames = self.frames(level, turn, segments)
        sources = sources_of(frames, self.planned.mirrors, self.planned.jobs, turn)
        number = self.versions.swap(sources, turn, until=self.until, **options)
        keep(self.path, number, frames, {})
        for levels, each in zip(self.expected if shown else (), frames, strict=False):
            levels[turn * SEGMENT : turn * SEGMENT + each.shape[0]] = each.levels()
        return number

    def fits(self) -> None:
        """What the resin saw is what was expected, wherever it was replaced."""
        masks = self.planned.jobs[0].masks
        self.stand.monitor._sources = tuple(
            WebFrames(lambda low, high, levels=levels: levels[low:high].copy(), POSES, self.planned.mirrors[0], masks)
            for levels in self.expected
        )
        verdict = self.stand.monitor.verdict()
        assert verdict.frames == len(self.planned.jobs) * POSES * self.planes
        assert verdict.greatest < 1e-6 and verdict.beside < 1e-9, verdict

    def shown_versions(self, told: RunRecord, engine: int = 0) -> list[int]:
        """Of each segment that was shown, which must have one alone."""
        shown = told.shown[told.shown["engine"] == engine]
        number = shown["slot"] // (SEGMENT * self.planes)
        each = [set(shown["version"][number == k].tolist()) for k in range(int(number.max()) + 1)]
        assert all(len(one) == 1 for one in each), each
        return [one.pop() for one in each]


def held(made: Rolled) -> None:
    """No comparison before the end: until then nobody knows which version is right."""
    made.stand.monitor.due = lambda: None


@pytest.mark.parametrize("engines", [1, 2])
def test_segments_to_come_are_replaced_where_one_begins(tmp_path: Path, engines: int) -> None:
    made = Rolled(tmp_path, engines)
    held(made)
    slots = 3 * SEGMENT
    made.happens = {5: lambda: made.swap(40, 1, 2), slots + 9: lambda: made.swap(90, 4)}
    told = made.run()
    assert told.state is PrintState.COMPLETE, told.message
    assert [made.shown_versions(told, k) for k in range(engines)] == [[0, 1, 1, 0, 2]] * engines
    assert told.shown["frame"][::engines].tolist() == made.planned.schedule.frame.tolist()
    made.fits()
    swaps = [event for event in told.events if event["event"] == "swap"]
    assert [(each["version"], each["turn"], each.get("until")) for each in swaps] == [(1, 1, 3), (2, 4, None)]
    light = account(told)
    assert light is not None and light.complete and set(light.versions) == {0, 1, 2}
    poses = {
        number: np.unique(np.flatnonzero(each.sure[0]) // (3 * SEGMENT)) for number, each in light.versions.items()
    }
    assert {number: each.tolist() for number, each in poses.items()} == {0: [0, 3], 1: [1, 2], 2: [4]}


@pytest.mark.parametrize("rig", ["mirrors", "stage"])
def test_a_version_that_comes_late_is_dropped_and_no_segment_shows_two(tmp_path: Path, rig: str) -> None:
    advance = float(plan(web(tmp_path / "film.vam", None), read_rig("emulated")).schedule.advance)
    stage = parse_rig(RIG.replace("microsteps = 1000", f"microsteps = {1000 / advance!r}"))
    made = Rolled(tmp_path, rig=None if rig == "mirrors" else stage, masks=None)
    held(made)
    lead = made.play._boundaries(2).lead
    assert 2 < lead < SEGMENT - 4, "a segment is not at the mirrors as a whole while the one before it is shown"
    made.happens = {
        SEGMENT - lead - 6: lambda: made.swap(40, 1, 1),
        2 * SEGMENT - 2: lambda: made.swap(90, 2, 1, shown=False),
        3 * SEGMENT + 2: lambda: made.swap(100, 3, 1, shown=False),
        3 * SEGMENT + 4: lambda: made.swap(110, 4),
    }
    told = made.run()
    assert told.state is PrintState.COMPLETE, told.message
    assert made.shown_versions(told) == [0, 1, 0, 0, 4]
    made.fits()
    dropped = [event for event in told.events if event["event"] == "swap dropped"]
    assert [each["version"] for each in dropped] == [2, 3] and "frames of segment 2" in dropped[0]["why"]


def test_all_projectors_of_a_web_swap_or_none(tmp_path: Path) -> None:
    made = Rolled(tmp_path, 2, masks=None)
    held(made)

    def ahead() -> None:
        queue = made.play._queues[1]
        taken, queue._taken = queue._taken, 2 + 2 * SEGMENT + 1
        made.swap(40, 2, shown=False)
        assert made.versions._offered is not None
        made.print._swap()
        queue._taken = taken

    made.happens = {35: ahead}
    told = made.run()
    assert [made.shown_versions(told, k) for k in (0, 1)] == [[0] * 5] * 2
    assert [event["version"] for event in told.events if event["event"] == "swap dropped"] == [1]
    made.fits()


def test_a_version_of_a_web_has_no_more_light_than_the_segments_it_replaces(tmp_path: Path) -> None:
    made = Rolled(tmp_path, allowance=0.25)
    made.versions.check(1, 1.25, None, 2)
    with pytest.raises(BadInput, match="1.3 times the light of the segments .* 1.25 are allowed"):
        made.versions.check(1, 1.3, None, 2)
    for turn, light, until in ((0, 1.0, None), (5, 1.0, None), (2, 1.0, 2), (2, float("nan"), 3)):
        with pytest.raises(BadInput):
            made.versions.check(turn, light, None, until)
    for turn, poses in ((1, SEGMENT - 1), (4, SEGMENT), (1, 0), (0, SEGMENT), (3, 2 * SEGMENT)):
        with pytest.raises(BadInput, match="whole segments of 30 angles"):
            replaced(made.planned, turn, poses)
    jobs, until = replaced(made.planned, 4, POSES - 4 * SEGMENT)
    assert jobs[0].shape[0] == 10 and until is None


def test_a_version_may_end_a_web_sooner(tmp_path: Path) -> None:
    made = Rolled(tmp_path, masks=None)
    budget = made.play.schedule.on.sum()
    made.happens = {5: lambda: made.swap(40, 1, stop=3)}
    told = made.run()
    lit = told.shown[told.shown["frame"] >= 0]
    assert lit["slot"].max() == 3 * SEGMENT - 1 and "after 3 segments" in told.message
    assert told.state is PrintState.COMPLETE, told.message
    armed = made.print.guard.budget
    assert armed is not None and armed.limit == pytest.approx(1.01 * budget * 1e-9 * 90 / 130, rel=0.01)


def test_versions_of_segments_lie_over_each_other() -> None:
    class Bits:
        bits = 8

    versions = FrameVersions([Bits()] * 1, 10, 6, unit="segment", slots=55)  # type: ignore[list-item]
    versions.restore(version(1, 1, None))
    versions.restore(version(2, 3, 4))
    versions.restore(version(3, 2, 5))
    assert [versions.at(10 * k) for k in range(6)] == [0, 1, 3, 3, 3, 1] and versions.end == 55
    versions.restore(version(4, 4, None))
    assert [versions.at(10 * k) for k in range(6)] == [0, 1, 3, 3, 4, 4]
    frames = np.arange(55)
    assert [versions.split_number(int(number)) for number in versions.order(frames)[[0, 25, 54]]] == [
        (0, 0),
        (3, 25),
        (4, 54),
    ]
    assert Boundaries(10, 0, 13).horizon(0) == 20, "a lead longer than a segment reaches into the one behind the next"


def version(number: int, turn: int, until: int | None) -> Any:
    from vamgpu.hosts.frames.versions import FrameVersion

    return FrameVersion(number, (), turn, None, 1.0, until)


def test_another_host_goes_on_with_the_versions_of_a_web(tmp_path: Path) -> None:
    made = Rolled(tmp_path)
    held(made)
    died = RuntimeError("the host is gone")

    def dies() -> None:
        made.print.guard._release_process()
        raise died

    made.happens = {5: lambda: made.swap(40, 1, 2), 20: lambda: made.swap(90, 2, 1), 150: dies}
    made.play.halt = made.play.doubtful = lambda: range(0)
    state = RunFolder.state
    RunFolder.state = lambda self, change: None if change.after.ended else state(self, change)  # type: ignore[method-assign]
    try:
        with pytest.raises(RuntimeError, match="is gone"):
            made.run()
    finally:
        RunFolder.state = state  # type: ignore[method-assign]
    made.stand.emulated.clock.sleep(SECOND)
    made.stand.emulated.alps[0].disconnect()
    machines = made.stand.emulated.machines(made.stand.machines.microsteps)  # type: ignore[union-attr]
    ended, job = carry_out(made.planned, machines, made.path, resume=True)
    told = read_run(made.path)
    assert ended.ended and told.shown["slot"].tolist() == [*range(3 * POSES)]
    assert made.shown_versions(told) == [0, 1, 2, 0, 0]
    assert job.player.versions is not None and job.player.versions.last == 2


def test_frames_of_slices_are_not_replaced_and_wires_carry_a_part_of_a_segment(tmp_path: Path) -> None:
    planned = plan(web(tmp_path / "web.vam"), read_rig("emulated"), rehearsed=True)
    assert boundary(planned) == 3 * SEGMENT
    stand = rehearsal(planned)
    plain, live = check(planned, stand.machines), check(planned, stand.machines, live=True)
    assert plain is not None and live is not None and live.depth <= SEGMENT and live.turn is None
    other = plan(
        [web(tmp_path / "a.vam"), web(tmp_path / "b.vam", segment=65)], read_rig("emulated"), rehearsed=True, turns=1
    )
    with pytest.raises(BadInput, match=r"segments of \[30, 65\] angles"):
        planned_versions(other)


def planned_live(
    monkeypatch: pytest.MonkeyPatch, job: Path, run: Path, order: LiveOrder, waits: dict[int, Callable[..., object]]
) -> RunRecord:
    """Print a web in virtual time, which stands at some slots until something is so."""
    planned = plan(job, read_rig("emulated"), rehearsed=True, turns=1)
    stand, saw = rehearsal(planned), LiveLink.saw

    def sees(link: LiveLink, seen: StatusPoll) -> None:
        saw(link, seen)
        for slot in [slot for slot in waits if seen.frames and seen.frames[-1].slot >= slot]:
            until, end = waits.pop(slot), time.monotonic() + 60
            while not until(link):
                assert time.monotonic() < end, (slot, link._board.now.live)
                time.sleep(0.005)

    monkeypatch.setattr(LiveLink, "saw", sees)
    state, _ = carry_out(planned, stand.machines, run, Board(), live=order)
    told = read_run(run)
    assert state is PrintState.COMPLETE, told.message
    return told


@pytest.mark.slow
def test_a_planning_process_replaces_segments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job, run = web(tmp_path / "web.vam"), tmp_path / "run"
    task = task_of(plan(job, read_rig("emulated"), rehearsed=True, turns=1), run)
    assert (task["kind"], task["turns"], task["frames"], task["shape"][0]) == ("web", 5, 3 * SEGMENT, SEGMENT)
    waits = {3: answered(1), 3 * SEGMENT + 3: answered(3)}
    told = planned_live(monkeypatch, job, run, LiveOrder("live_workers:rolls", allowance=0.1), waits)
    assert kinds(told) == ["swap", "live refused", "swap"]
    assert told.shown["version"][:: 3 * SEGMENT].tolist() == [0, 1, 0, 2, 2]
    refused = next(event["why"] for event in told.events if event["event"] == "live refused")
    assert "whole segments of 30 angles" in refused
    assert (kept_frames(run, 2, 0).levels() == 5).all() and last_kept(run) == 2


@pytest.mark.slow
def test_a_web_whose_lamp_gets_weak_is_mended_while_it_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, run = bars().write(tmp_path / "bars.vam"), tmp_path / "run"
    frames = folder.segments[0].frames[1]
    waits = {WEAK + 2: answered(1), 2 * frames + 2: answered(2)}
    told = planned_live(monkeypatch, folder.path, run, LiveOrder("web_workers:mends", allowance=0.6), waits)
    assert told.shown["version"][::frames].tolist() == [0, 0, 0, 1, 2] and "live lost" not in kinds(told)
    shown = folder.read("frames", 0, folder.frames)
    for number, turn in ((1, 3), (2, 4)):
        levels = kept_frames(run, number, 0).levels()
        shown[turn * frames : turn * frames + len(levels)] = levels
    mended = WebFolder.open(tmp_path / "4.vam")
    assert mended.complete and np.array_equal(mended.read("frames", 0, mended.frames), shown), "what was planned on"
    gain = np.where(np.arange(folder.frames) < WEAK, 1.0, 0.8)
    solid = prove_web(folder).threshold
    unchanged, now = (
        [each.iou for each in prove_web(each, gain=gain, threshold=solid).segments] for each in (folder, mended)
    )
    assert max(unchanged[2:]) < 0.99 and now[2:] == [1.0, 1.0], (unchanged, now)
    assert now[:2] == unchanged[:2], "what was over, or lit by committed frames alone"
