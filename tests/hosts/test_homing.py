"""Prints that find pose 0 by an index mark, and find it again before they go on: lost steps are made good and told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from doubles import MIRRORS, STEPS, Scene, roll
from test_planning import vial

from vamgpu.hosts.drivers.controller import Index
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import carry_out, plan, rehearsal
from vamgpu.hosts.rigs.config import parse_rig
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.schedule import Schedule

SLOTS = 24
PRINTS = {"vial": turned(SLOTS, speed=60, engines=MIRRORS), "web": roll(SLOTS)}


def marked(run: Path, schedule: Schedule) -> Scene:
    """A print whose mark comes every 24 poses, at microstep 500; resin is where the shaft is."""
    scene = Scene(run, schedule)
    senses: Any = scene.emulated.controller.senses
    senses.mark = (500, SLOTS * STEPS)
    scene.machines.controller.feedback(index=Index(SLOTS * float(schedule.advance), 0.5 * float(schedule.advance)))
    web = scene.emulated.controller.web
    lost = lambda now: senses.shaft(0) + web.position(now)  # noqa: E731
    scene.emulated.recorder._position = lambda now: (lost(now) - 500) / STEPS
    if schedule.unit == "deg":
        scene.emulated.recorder.first = 0.0
    return scene


def slip(scene: Scene, poses: float) -> None:
    now, controller = scene.emulated.clock.now(), scene.emulated.controller
    controller.senses.slip(now, controller.microsteps(now), round(poses * STEPS))


def shares(scene: Scene) -> Any:
    turn = SLOTS if scene.schedule.unit == "deg" else None
    return scene.seconds(turn=turn)[:SLOTS] * 1e9 / scene.schedule.on[0]


@pytest.mark.parametrize("kind", PRINTS)
def test_lost_steps_in_a_pause_are_made_good_by_the_mark(run: Path, kind: str) -> None:
    scene = marked(run, PRINTS[kind])
    scene.paused(7)
    slip(scene, 3.5)
    assert scene.print.run() is PrintState.COMPLETE
    assert shares(scene) == pytest.approx(1.0, abs=0.01), "each pose once, and in its place"
    first, second = (event for event in scene.read().events if event["event"] == "segment")
    assert "lost" not in first and first["zero"] != second["zero"]
    assert second["lost"] == pytest.approx(3.5 * float(scene.schedule.advance), abs=0.2 * float(scene.schedule.advance))


def test_two_prints_have_pose_0_at_the_same_angle(tmp_path: Path) -> None:
    scene = marked(tmp_path / "one", PRINTS["vial"])
    slip(scene, 4.2)
    assert scene.print.run() is PrintState.COMPLETE
    assert shares(scene) == pytest.approx(1.0, abs=0.01), "by the mark, wherever the motor was"


def test_a_mark_that_does_not_come_gets_no_light(run: Path) -> None:
    scene = marked(run, PRINTS["vial"])
    now, controller = scene.emulated.clock.now(), scene.emulated.controller
    controller.senses.stall(now, controller.microsteps(now))
    with pytest.raises(InterlockOpen, match="no index mark"):
        scene.print.run()
    assert not scene.lit()


def test_a_rig_with_an_index_is_rehearsed_with_it(tmp_path: Path) -> None:
    rig = parse_rig(
        '[rig]\nname = "lab"\nmachine = "vial"\n[controller]\nport = "/dev/x"\n[motion]\ndriver = "controller"\n'
        'microsteps = 80.0\n[display]\ndriver = "alp"\nlibrary = "x.so"\n[[feedback]]\ndriver = "index"\n'
    )
    planned = plan(vial(tmp_path / "job.vam"), rig, rehearsed=True, turns=1)
    stand = rehearsal(planned)
    assert carry_out(planned, stand.machines, tmp_path / "run")[0] is PrintState.COMPLETE
    senses = stand.emulated.controller.senses
    assert senses.marks >= 2 and senses._shift % senses.mark[1] == senses.mark[0], "position 0 is at the mark"
    assert stand.monitor.verdict().greatest < 1e-6 and read_run(tmp_path / "run").state is PrintState.COMPLETE
