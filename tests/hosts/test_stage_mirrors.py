"""Mirrors that a stage triggers, without a controller: every frame at its pose, and dark whatever goes wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chances import light_of
from test_planning import web

from vamgpu.errors import BadInput, DeviceError, StorageError, VamError
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.record import FrameRecord, RunFolder, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import PrintPlan, Rehearsal, carry_out, limits, plan, player, rehearsal
from vamgpu.hosts.rigs.config import parse_rig, read_rig
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.timing import SECOND

RIG = """
[rig]
name = "stage"
machine = "any"
[motion]
driver = "zaber"
port = "/dev/ttyUSB0"
microsteps = 1000
[display]
driver = "alp"
library = "libalp.so"
[light]
driver = "laser"
port = "/dev/ttyUSB1"
"""
GATED = RIG.replace('[light]\ndriver = "laser"\nport = "/dev/ttyUSB1"\n', '[controller]\nport = "/dev/ttyACM0"\n')
SHINING = RIG.replace('driver = "laser"\nport = "/dev/ttyUSB1"', 'driver = "display"')


class Scene:
    """A print on an emulated rig; ``happens`` maps the number of a slot that was shown to what is done then."""

    def __init__(self, job: Path, place: Path, rig: str = RIG, turns: int = 1) -> None:
        self.planned: PrintPlan = plan(job, parse_rig(rig), turns=turns, rehearsed=True)
        self.stand: Rehearsal = rehearsal(self.planned)
        self.emulated: Any = self.stand.emulated
        self.folder = RunFolder.begin(place, {}, "")
        self.player: Any = player(self.planned, self.stand.machines)
        self.print = Print(self.player, self.folder, limits=limits(self.planned.rig))
        self.happens: dict[int, Callable[[], object]] = {}
        self.place, self.since = place, 0
        keep = self.folder.shown

        def kept(shown: FrameRecord) -> None:
            keep(shown)
            if shown.slot in self.happens:
                self.since = self.emulated.clock.now()
                self.happens.pop(shown.slot)()

        self.folder.shown = kept  # type: ignore[method-assign]

    def fails(self, why: str, kind: type[VamError] = InterlockOpen) -> None:
        with pytest.raises(kind, match=why):
            self.print.run()
        assert not self.lit() and self.emulated.stage.track.velocity(self.emulated.clock.now()) == 0

    def lit(self) -> bool:
        """Whether light falls through the mirrors, from now on for a second."""
        before = sum(float(light.sum()) for light in self.emulated.recorder.light.values())
        self.emulated.clock.sleep(SECOND)
        return sum(float(light.sum()) for light in self.emulated.recorder.light.values()) > before

    def dark_within(self, seconds: float) -> bool:
        """Whether the lamp went off so soon after what happened."""
        times, channels = self.emulated.recorder._times, self.emulated.recorder._channels
        return channels[-1] == 0 and times[-1] - self.since <= seconds * SECOND


class Stray:
    """An edge on the trigger's wire as soon as the mirrors are ready for one."""

    def __init__(self, alp: Any) -> None:
        self.alp, self.at = alp, alp._current[1] + 1

    def due(self) -> int | None:
        return self.at

    def advance(self, now: int) -> None:
        self.at = None
        self.alp.trigger(now)


@pytest.mark.parametrize("rig", [RIG, GATED, SHINING], ids=["laser", "gate", "display"])
def test_every_frame_is_at_its_pose(job: Path, tmp_path: Path, rig: str) -> None:
    planned = plan(job, parse_rig(rig), rehearsed=True, turns=2)
    stand = rehearsal(planned)
    assert carry_out(planned, stand.machines, tmp_path / "run")[0] is PrintState.COMPLETE
    verdict = stand.monitor.verdict()
    assert verdict.frames == 36 and verdict.greatest < 1e-6 and verdict.beside < 1e-9, verdict
    frames = planned.jobs[0].frames
    assert frames is not None and np.array_equal(stand.seen(planned).images.numpy(), frames.images.numpy())
    run = read_run(tmp_path / "run")
    assert run.shown["slot"].tolist() == list(range(72)) and not run.shown["dark"].any()
    lacking = {one["about"] for one in run.asked["guarantees"] if not one["holds"]}
    assert lacking == {"lamp", "position"} | (set() if rig is GATED else {"light", "lease", "interlock"})


def test_a_web_is_triggered_by_its_stage_too(tmp_path: Path) -> None:
    film = web(tmp_path / "web.vam", None)
    advance = plan(film, read_rig("emulated"), speed=0.8).schedule.advance
    rig = parse_rig(RIG.replace("microsteps = 1000", f"microsteps = {1000 / float(advance)!r}"))
    planned = plan(film, rig, speed=0.8, rehearsed=True)
    stand = rehearsal(planned)
    assert carry_out(planned, stand.machines, tmp_path / "run")[0] is PrintState.COMPLETE
    verdict = stand.monitor.verdict()
    assert verdict.frames == len(planned.schedule) and verdict.greatest < 1e-6 and verdict.beside < 1e-9, verdict


def test_a_pause_is_resumed_where_it_was(job: Path, tmp_path: Path) -> None:
    scene = Scene(job, tmp_path / "run")
    scene.happens[9] = scene.print.pause
    assert scene.print.run() is PrintState.PAUSED and not scene.lit()
    assert scene.print.run() is PrintState.COMPLETE
    scene.folder.close()
    assert read_run(scene.place).shown["slot"].tolist() == list(range(36))
    verdict = scene.stand.monitor.verdict()
    assert verdict.greatest < 1e-6 and verdict.beside < 1e-9, verdict


def test_a_lost_trigger_is_dark(job: Path, tmp_path: Path) -> None:
    lost = Scene(job, tmp_path / "lost")
    lost.happens[9] = lambda: setattr(lost.emulated, "lose_triggers", 1)
    lost.fails("frame 45 is shown; expected frame 46")
    assert lost.dark_within(0.25 + 0.03), "a poll after the next pose"


def test_a_stray_edge_shifts_no_frame(job: Path, tmp_path: Path) -> None:
    scene = Scene(job, tmp_path / "run")
    scene.happens[9] = lambda: scene.emulated.clock.attach(Stray(scene.emulated.alps[0]))
    assert scene.print.run() is PrintState.COMPLETE
    verdict, early = scene.stand.monitor.verdict(), 1 - 0.98
    assert 0 < verdict.greatest < early, "mirrors that show a frame take no trigger: one comes early, by their pause"


def test_a_stage_that_stalls_or_slows_is_dark(job: Path, tmp_path: Path) -> None:
    for speed in (0.0, 3.0):
        scene = Scene(job, tmp_path / f"run{speed}")
        scene.happens[9] = lambda scene=scene, speed=speed: scene.emulated.turn(speed)
        scene.fails("off position|expected frame")
        assert scene.dark_within(0.5 / (4.0 - speed) + 0.05), "a poll after half a pose of error"


def test_mirrors_that_count_wrongly_before_the_print_get_no_light(job: Path, tmp_path: Path) -> None:
    scene = Scene(job, tmp_path / "run")
    scene.emulated.lose_triggers = 3
    scene.fails("of which the mirrors counted")
    assert not scene.emulated.recorder.light and not any(scene.emulated.recorder._channels)


def test_a_stage_that_does_not_turn_gets_no_light(job: Path, tmp_path: Path) -> None:
    scene = Scene(job, tmp_path / "run")
    run = scene.player._stage.run
    scene.player._stage.run = lambda speed: run(0.2 * speed)
    scene.fails("off its speed|does not turn")
    assert not scene.emulated.recorder.light


def test_an_unplugged_stage_or_line_is_dark_by_the_others(job: Path, tmp_path: Path) -> None:
    scene = Scene(job, tmp_path / "stage")
    scene.happens[9] = lambda: scene.emulated.stage_port.unplug()
    with pytest.raises(DeviceError):
        scene.print.run()
    assert scene.dark_within(0.05) and not scene.lit()
    other = Scene(job, tmp_path / "line")

    def pull() -> None:
        other.emulated.line.unplugged = True
        other.print.stop()

    other.happens[9] = pull
    other.print.run()
    assert not other.lit(), "the laser shines on, and the mirrors have turned away"
    assert other.emulated.recorder._channels[-1] == 1


def open_door(scene: Scene) -> None:
    scene.emulated.controller.open_interlock(scene.emulated.clock.now())
    scene.emulated.controller.interlock_closed = True


def lose_mirrors(scene: Scene) -> None:
    """They answer no more, and show on what they have."""
    dmd: Any = scene.stand.machines.mirrors[0]  # type: ignore[union-attr]

    def gone(*_: object) -> None:
        scene.emulated.clock.sleep(3 * SECOND // 10)
        raise DeviceError("the mirrors do not answer")

    dmd.call, scene.call = gone, dmd.call  # type: ignore[attr-defined]


def find_mirrors(scene: Scene) -> None:
    scene.stand.machines.mirrors[0].call = scene.call  # type: ignore


BREAKS: dict[str, tuple[str, Callable[[Scene], object], Callable[[Scene], object], int]] = {
    "door": (GATED, open_door, lambda scene: None, 2),
    "lease": (GATED, lambda scene: scene.emulated.clock.sleep(SECOND), lambda scene: None, 6),
    "line": (GATED, lambda scene: scene.emulated.port.unplug(), lambda scene: scene.emulated.port.replug(), 4),
    "mirrors": (RIG, lose_mirrors, find_mirrors, 12),
}
"""Of a rig: what makes it dark, what mends that, and how many slots nobody can have seen."""


@pytest.mark.parametrize("fault", BREAKS)
def test_what_the_stage_triggered_when_the_light_went_off_is_told(job: Path, tmp_path: Path, fault: str) -> None:
    """The light went off at an unknown time, and the stage triggered on until it was told to rest."""
    rig, breaks, repairs, most = BREAKS[fault]
    scene = Scene(job, tmp_path / "run", rig)
    scene.happens[9] = lambda: breaks(scene)
    with pytest.raises(VamError):
        scene.print.run()
    assert scene.print.states.state is PrintState.HELD
    assert not scene.lit() and scene.emulated.recorder._channels[-1] == 0
    repairs(scene)
    assert scene.print.run() is PrintState.INCOMPLETE
    scene.folder.close()
    record, table = read_run(scene.place), scene.planned.schedule
    (event,) = (event for event in record.events if event["event"] == "unseen")
    unseen = range(event["first"], event["stop"])
    assert unseen.start == 9 and len(unseen) <= most, "no more than could not be seen"
    assert record.shown["slot"].tolist() == list(range(36))
    shares = light_of(scene.planned, scene.emulated.recorder) / table.on
    assert (shares < 1.004).all(), "nothing is lit twice"
    short = np.flatnonzero(shares < 0.99).tolist()
    assert set(short) <= set(unseen) and (fault in ("line", "mirrors") or short)


def test_a_stage_that_cannot_be_asked_leaves_no_print_to_go_on(job: Path, tmp_path: Path) -> None:
    scene = Scene(job, tmp_path / "run", GATED)
    scene.happens[9] = lambda: scene.emulated.stage_port.unplug()
    with pytest.raises(DeviceError):
        scene.print.run()
    assert scene.print.states.state is PrintState.ERROR, "nobody knows what the resin saw"


def test_such_a_print_is_not_resumed_by_another_host(job: Path, tmp_path: Path) -> None:
    scene = Scene(job, tmp_path / "run")
    scene.folder.close()
    with pytest.raises((BadInput, StorageError), match="stage triggered the mirrors"):
        carry_out(scene.planned, scene.stand.machines, tmp_path / "run", resume=True)
