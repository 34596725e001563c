"""Frames whose light is in doubt are shown again where dose and budget allow it, and the record tells how it ended."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from chances import light_of
from test_planning import vial

from vamgpu.hosts.player.mending import Mending
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.account import account
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rig import carry_out, plan, player, rehearsal
from vamgpu.hosts.rigs.config import RigConfig, parse_rig, read_rig
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.printing.given_dose import GivenDose, ProvedDose

IMAGES = 36
PROVED = ProvedDose(seconds=11.5, irradiance=1.0, scale=1.0, least=0.9, most=1.3, right=True)
"""Four turns at 120 deg/s."""
CABLE = '[rig]\nname = "cable"\nmachine = "vial"\n[controller]\nport = "/dev/x"\n[motion]\ndriver = "zaber"\n' + (
    'port = "/dev/y"\n[display]\ndriver = "video"\nslots = 1\n'
)


def printed(place: Path, proved: ProvedDose, mend: bool, rig: RigConfig | None = None) -> tuple[PrintState, Any, Any]:
    """A vial whose door is opened in its second turn and closed again: its end, its plan and its machines."""
    planned = plan(vial(place / "job.vam", images=IMAGES), rig or read_rig("emulated"), speed=120.0, rehearsed=True,
                   exposure=proved)  # fmt: skip
    assert planned.dose is not None and planned.dose.turns == 4
    stand = rehearsal(planned)
    box, board, opened = stand.emulated.controller, Board(), list[int]()
    show = board.show

    def shown(**fields: object) -> None:
        show(**fields)
        if not opened and board.now.light and board.now.slot > IMAGES + 9:
            opened.append(board.now.slot)
            box.open_interlock(stand.emulated.clock.now())

    board.show = shown  # type: ignore[method-assign]

    def go_on(_: Any) -> bool:
        box.interlock_closed = True
        return True

    state = carry_out(planned, stand.machines, place / "run", board, go_on=go_on, mend=mend)[0]
    assert opened
    return state, planned, stand


@pytest.mark.parametrize("rig", [None, parse_rig(CABLE)], ids=["mirrors", "cable"])
def test_a_frame_that_was_cut_is_shown_again(tmp_path: Path, rig: RigConfig | None) -> None:
    state, planned, stand = printed(tmp_path, PROVED, True, rig)
    run = read_run(tmp_path / "run")
    (unseen,) = [event for event in run.events if event["event"] == "unseen"]
    (mended,) = [event for event in run.events if event["event"] == "mended"]
    assert (mended["first"], mended["stop"]) == (unseen["first"], unseen["stop"])
    found = account(run)
    assert state is PrintState.COMPLETE and found is not None and found.complete and found.unsure.any()
    assert not found.short.any() and "lit for an unknown time" in str(found)
    again = run.shown["frame"][run.shown["slot"] >= 4 * IMAGES]
    frames = {slot % IMAGES for slot in range(unseen["first"], unseen["stop"])}
    assert {*again.tolist()} - {-1} == frames
    if rig is None:
        got, (sure,), (unsure,) = light_of(planned, stand.emulated.recorder), found.sure, found.unsure
        assert (got >= sure - 1e6).all() and (got <= sure + unsure + 1e6).all()


@pytest.mark.parametrize(
    ("proved", "why"),
    [(replace(PROVED, most=1.2), "the dose could reach ×1.250; expected ×1.200 at most")],
)
def test_what_could_be_too_much_is_not_shown_again(tmp_path: Path, proved: ProvedDose, why: str) -> None:
    state, _, _ = printed(tmp_path, proved, True)
    run = read_run(tmp_path / "run")
    assert state is PrintState.INCOMPLETE and int(run.shown["slot"].max()) == 4 * IMAGES - 1
    assert [event["why"] for event in run.events if event["event"] == "not mended"] == [why]


def test_nothing_is_shown_again_unasked(tmp_path: Path) -> None:
    state, _, _ = printed(tmp_path, PROVED, False)
    assert state is PrintState.INCOMPLETE
    assert not any("mended" in event["event"] for event in read_run(tmp_path / "run").events)


def test_dark_slots_are_no_frame_that_is_shown_again(tmp_path: Path) -> None:
    frame, repeated, told = np.array([0, NONE, NONE, NONE, 1]), list[range](), list[Any]()
    schedule = SimpleNamespace(unit="deg", repeats=True, frame=frame, on=np.full(5, 10**9), power=np.ones((5, 1)))
    job: Any = SimpleNamespace(
        player=SimpleNamespace(schedule=schedule, repeat=repeated.append), guard=SimpleNamespace(signalled=False),
        _mending=Mending(GivenDose(PROVED, share=1.0, turns=4, seconds=12.0), 2.5), _cancelled=False, power=1.0,
        _unwritten=told, _event=dict,
    )  # fmt: skip
    Print._repeat(job, range(5))
    assert repeated == [range(5)], told
    planned = plan(vial(tmp_path / "job.vam", images=IMAGES), parse_rig(CABLE), speed=120.0, turns=2, rehearsed=True)
    playing: Any = player(planned, rehearsal(planned).machines)
    playing._turns = 2
    playing.repeat(range(4, 6))
    assert playing.add_repeats() and len(playing.schedule) == 3 * IMAGES
    playing.repeat(range(2 * IMAGES, 3 * IMAGES))
    assert playing.add_repeats() and np.count_nonzero(playing.schedule.frame[3 * IMAGES :] != NONE) == 2


def test_dose_and_budget_limit_what_is_shown_again() -> None:
    dose = GivenDose(PROVED, share=1.0, turns=4, seconds=12.0)
    assert Mending(None, 1.0).refused([1], 0.1) == "the proved dose is not known"
    mending = Mending(dose, 1.0)
    assert mending.refused([1, 2], 0.6) is None
    assert mending.refused([2], 0.1) == "the dose could reach ×1.500; expected ×1.300 at most"
    assert mending.refused([3], 0.5) == "they need 1.1 of light; the budget has 1 over the plan"
    assert mending.refused([3], 0.4) is None
