"""Vials before a video projector, printed on an emulated booth: every angle in place, and dark whatever goes wrong."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vamgpu.errors import BadInput, DeviceLost, Underrun, WrongDevice
from vamgpu.hosts.drivers.stages import ZaberStage
from vamgpu.hosts.emulators.rigs import MICROSTEPS, EmulatedVideoRig
from vamgpu.hosts.emulators.screen import LitSlot
from vamgpu.hosts.player.run import Print, SafetyLimits
from vamgpu.hosts.player.video import LEAD, SpinningPlayer
from vamgpu.hosts.records.record import RunFolder, RunRecord, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.safety.interlock import DEFAULT_LENGTH, InterlockOpen, OverDose
from vamgpu.hosts.schedules.limits import HdmiTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import web
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.hosts.schedules.video import vial

SIZE, FRAME = (1, 4), SECOND / 60
DISPLAY = HdmiTiming(pixels=(4, 1))
SHARE = 0.94
"""Of each slot in which the emulated screen is lit: between two slots there is time for what is rounded."""


class Coded:
    """Frames that hold their number; things may happen when one is asked for."""

    def __init__(self) -> None:
        self.asked = 0
        self.happens: dict[int, Callable[[], object]] = {}
        self.ready: Callable[[int], bool] = lambda number: True

    def frame(self, number: int) -> np.ndarray | None:
        self.asked += 1
        self.happens.get(self.asked, lambda: None)()
        code = [255, number % 256, number // 256, 0]
        return np.array([code], np.uint8) if self.ready(number) else None


class Room:
    """A booth, a print in it, and what its resin saw: frame and true pose at the middle of each lit slot."""

    def __init__(
        self, path: Path, turns: int = 1, *, display: HdmiTiming = DISPLAY, speed: float = 40, added: int = 1
    ) -> None:
        self.emulated, self.frames, self.path = EmulatedVideoRig(360, SIZE, share=SHARE), Coded(), path
        self.schedule, self.display, self.added = vial(360, speed=speed, display=display, turns=turns), display, added
        self.seen: list[tuple[int, float]] = []
        integrate = self.emulated.screen.on_slot
        assert integrate is not None

        def slot(slot: LitSlot) -> None:
            integrate(slot)
            levels, middle = slot.levels[0].tolist(), (slot.start + slot.end) // 2
            if levels[0] and self.emulated.controller.lit(middle):
                self.seen.append((levels[1] + 256 * levels[2], self.emulated.recorder._position(middle)))

        self.emulated.screen.on_slot = slot
        self.machines = self.emulated.machines()
        self.folder = RunFolder.begin(path, {}, "")
        self.print = Print(self.player(), self.folder)

    def player(self) -> SpinningPlayer:
        return SpinningPlayer(self.schedule, self.display, self.machines, self.frames, turns=self.added)

    def run(self) -> PrintState:
        try:
            return self.print.run()
        finally:
            self.folder.close()

    @property
    def told(self) -> RunRecord:
        return read_run(self.path)

    def slots(self) -> np.ndarray:
        """Slots of light of each frame."""
        return np.bincount([number for number, _ in self.seen], minlength=360)

    def astray(self) -> np.ndarray:
        """How far each lit frame was from its pose [poses]: 0 where the pose was its own."""
        off = np.array([where - number for number, where in self.seen])
        off = (off + 180) % 360 - 180
        return np.where((off >= 0) & (off < 1), 0.0, np.minimum(np.abs(off), np.abs(off - 1)))

    def dark_after(self, fault: int) -> int:
        """When the lamp went off for good, after a time [ns]."""
        controller = self.emulated.controller
        assert not controller.light
        end = max((end for _, end, _, _ in controller.intervals), default=fault)
        return end - fault


@pytest.mark.slow
def test_ten_minutes_at_40_degrees_a_second_show_every_angle_in_place(tmp_path: Path) -> None:
    room = Room(tmp_path / "run", turns=67)
    assert room.run() is PrintState.COMPLETE and room.emulated.clock.now() > 600 * SECOND
    assert not room.astray().any() and (room.slots() == 67 * 3).all()
    numbers = np.array([number for number, _ in room.seen])
    assert (np.diff(np.flatnonzero(np.diff(numbers))) == 3).all(), "the cadence is even"
    shown = room.told.shown
    assert shown["slot"].tolist() == list(range(67 * 360)) and not shown["dark"].any()
    assert np.array_equal(shown["frame"], shown["position"] % 360)
    assert np.abs(shown["late"]).max() < 0.05 * SECOND / 120, "the stage is in step with the cable"


def test_the_lamp_opens_at_a_boundary_of_turns_and_closes_after_the_last(tmp_path: Path) -> None:
    room = Room(tmp_path / "run")
    assert room.run() is PrintState.COMPLETE
    ((on, off, _, _),) = room.emulated.controller.intervals
    position = room.emulated.recorder._position
    assert -40 * LEAD <= position(on) - 360 * round(position(on) / 360) < 0
    assert 0 < position(off) - 720 < 40 * 3 / 60, "dark within three video frames"
    assert room.emulated.stage.track.velocity(room.emulated.clock.now()) == 0


def test_a_slipped_refresh_drops_to_the_current_angle_and_makes_amends(tmp_path: Path) -> None:
    room = Room(tmp_path / "run", turns=2)
    begin = 560
    room.emulated.screen.hitches = {begin + 50: 1, begin + 90: 3, begin + 300: 2}
    assert room.run() is PrintState.COMPLETE
    astray, shown = room.astray(), room.told.shown
    # of each slip the frame before it, shown again, and the one that waited
    assert 0 < np.count_nonzero(astray) <= 2 * (1 + 1) + 2 * (3 + 1) + 2 * (2 + 1) and astray.max() < 2.1
    repeats = 2 * (1 + 3 + 2)
    assert (room.slots() >= 6).all() and room.slots().sum() == 360 * 6 + repeats, "no slot is missing, none twice"
    told = shown["on_time"][shown["dark"] == 0].sum()
    assert told == room.slots().sum() * (int(room.schedule.on[0]) // 3), "the record tells what was"
    add_repeats = shown[720:]
    assert len(add_repeats) == 360 and 0 < np.count_nonzero(add_repeats["frame"] != NONE) < 12
    assert shown["late"].max() > 2 * FRAME


def test_a_host_that_stands_still_shows_the_current_angle_next(tmp_path: Path) -> None:
    room = Room(tmp_path / "run", turns=3)
    room.frames.happens = {300: lambda: room.emulated.clock.sleep(90_000_000)}
    read, reads = room.machines.stage.position, iter(range(10**6))

    def slow() -> float:
        if next(reads) == 1300:
            room.emulated.clock.sleep(70_000_000)
        return read()

    room.machines.stage.position = slow  # type: ignore[method-assign]
    assert room.run() is PrintState.COMPLETE
    assert 0 < np.count_nonzero(room.astray()) <= 2 * (6 + 1) + 2 * (5 + 1) and (room.slots() >= 9).all()


def test_light_that_a_screen_repeats_is_counted(tmp_path: Path) -> None:
    """Six video frames of light that no plan wanted are more than a hundredth of a turn."""
    room = Room(tmp_path / "run")
    room.emulated.screen.hitches = {800: 6}
    with pytest.raises(OverDose):
        room.run()
    assert not room.emulated.controller.light


def test_a_screen_that_beats_otherwise_is_followed(tmp_path: Path) -> None:
    """A screen of 60 Hz where 59.94 was told: the count of slots is corrected when it is a slot off."""
    display = HdmiTiming(refresh=59.94, pixels=(4, 1))
    room = Room(tmp_path / "run", turns=4, display=display, speed=39.96)
    assert room.run() is PrintState.COMPLETE
    assert room.astray().max() < 0.3, "no farther than a slot"
    assert (room.slots() == 12).all()


def test_a_late_frame_is_black_and_shown_in_a_turn_that_is_added(tmp_path: Path) -> None:
    room = Room(tmp_path / "run")
    room.frames.ready = lambda number: number not in (100, 101) or room.frames.asked > 1000
    assert room.run() is PrintState.COMPLETE
    shown = room.told.shown
    assert np.flatnonzero(shown["dark"]).tolist() == [100, 101]
    assert [slot for slot in range(360, 720) if shown["frame"][slot] != NONE] == [460, 461]
    assert (room.slots() == 3).all() and not room.astray().any()
    assert len(room.emulated.controller.intervals) == 2, "dark between the turns"


def test_what_no_added_turn_shows_is_told(tmp_path: Path) -> None:
    room = Room(tmp_path / "run")
    room.frames.ready = lambda number: number != 100
    assert room.run() is PrintState.INCOMPLETE and "3 slots of frames were missed; 1 added turns" in room.told.message
    assert (
        "1 of 360 frames" in room.told.message and not room.emulated.controller.light and room.slots().sum() == 359 * 3
    )


def test_a_turn_without_any_frame_ends_the_print(tmp_path: Path) -> None:
    room = Room(tmp_path / "run", turns=3)
    room.frames.ready = lambda number: room.frames.asked < 600
    with pytest.raises(Underrun, match="a whole turn"):
        room.run()
    shown = room.told.shown
    assert 360 <= np.count_nonzero(shown["dark"]) <= 362 and not room.emulated.controller.light


POSE = SECOND // 40


@pytest.mark.parametrize(
    ("fault", "within"),
    [
        (lambda emulated: emulated.slip(-1.0), 2 * FRAME),
        (lambda emulated: emulated.slip(1.0), 2 * FRAME),
        (lambda emulated: emulated.turn(0.0), POSE / 2 + 2.7 * FRAME),  # the stage takes time too, 0.2 s from 40 deg/s
        (lambda emulated: emulated.turn(-40.0), POSE / 2 + 2.7 * FRAME),
        (lambda emulated: emulated.turn(60.0), 2 * POSE + 2 * FRAME),
    ],
    ids=["slips back", "slips on", "stops", "reverses", "races"],
)
def test_a_stage_that_is_elsewhere_is_dark(
    tmp_path: Path, fault: Callable[[EmulatedVideoRig], None], within: float
) -> None:
    room, at = Room(tmp_path / "run"), []
    room.emulated.stage.track.acceleration = 2e6

    def happens() -> None:
        at.append(room.emulated.clock.now())
        fault(room.emulated)

    room.frames.happens = {600: happens}
    with pytest.raises(InterlockOpen, match="off position"):
        room.run()
    assert 0 < room.dark_after(at[0]) <= within
    assert room.told.state is PrintState.HELD and room.emulated.stage.track.velocity(room.emulated.clock.now()) == 0


def test_a_vial_that_does_not_get_to_its_speed_gets_no_light(tmp_path: Path) -> None:
    room = Room(tmp_path / "run")
    room.emulated.stage.track.acceleration = 1000.0
    with pytest.raises(InterlockOpen, match="does not move at 40 deg"):
        room.run()
    assert not room.emulated.controller.intervals and not room.seen


def test_a_lost_screen_is_dark(tmp_path: Path) -> None:
    room, at = Room(tmp_path / "run"), []

    def pulled() -> None:
        at.append(room.emulated.clock.now())
        room.emulated.screen.unplug()

    room.frames.happens = {600: pulled}
    with pytest.raises(DeviceLost, match="screen is lost"):
        room.run()
    assert room.dark_after(at[0]) <= FRAME and room.told.state is PrintState.HELD
    room.emulated.clock.sleep(SECOND)
    assert len(room.seen) <= 600, "the frame it shows for good is dark"


def test_a_screen_that_hangs_is_dark_by_the_lease(tmp_path: Path) -> None:
    room = Room(tmp_path / "run")
    room.emulated.screen.hitches = {800: 120}
    with pytest.raises(InterlockOpen):
        room.run()
    assert room.emulated.controller.fault == "lease" and room.told.state is PrintState.HELD
    last = room.told.shown[-1]
    on, off, _, _ = room.emulated.controller.intervals[-1]
    assert off - on - int(last["slot"]) * POSE < DEFAULT_LENGTH + int(LEAD * SECOND)


def test_a_lost_stage_or_controller_is_dark(tmp_path: Path) -> None:
    for name in ("stage_port", "port"):
        room, at = Room(tmp_path / name), []

        def pulled(room: Room = room, at: list[int] = at, name: str = name) -> None:
            at.append(room.emulated.clock.now())
            getattr(room.emulated, name).unplug()

        room.frames.happens = {600: pulled}
        with pytest.raises(DeviceLost):
            room.run()
        room.emulated.clock.sleep(DEFAULT_LENGTH)
        assert room.dark_after(at[0]) <= (2 * FRAME if name == "stage_port" else DEFAULT_LENGTH)


def test_an_opened_door_ends_the_print(tmp_path: Path) -> None:
    room, at = Room(tmp_path / "run"), []

    def opened() -> None:
        at.append(room.emulated.clock.now())
        room.emulated.controller.open_interlock(room.emulated.clock.now())

    room.frames.happens = {600: opened}
    with pytest.raises(InterlockOpen, match="interlock"):
        room.run()
    assert room.dark_after(at[0]) == 0 and room.emulated.clock.now() - at[0] < SECOND


def test_an_emergency_stop_from_another_thread_leaves_the_window_to_its_own(tmp_path: Path) -> None:
    room = Room(tmp_path / "run")

    def stopped() -> None:
        thread = threading.Thread(target=room.print.stop)
        thread.start()
        thread.join()
        assert not room.emulated.controller.light

    room.frames.happens = {600: stopped}
    before = len(room.seen)
    assert room.run() is PrintState.CANCELLED
    assert before <= len(room.seen) <= 600


def test_a_pause_ends_with_a_whole_frame_and_the_next_meets_its_angle(tmp_path: Path) -> None:
    room = Room(tmp_path / "run", turns=2)
    angles: list[float] = []
    read = room.machines.stage.position
    room.machines.stage.position = lambda: angles.append(read()) or angles[-1]  # type: ignore[method-assign]
    room.frames.happens = {500: room.print.pause}
    assert room.print.run() is PrintState.PAUSED
    assert not room.emulated.controller.light and room.emulated.stage.track.velocity(room.emulated.clock.now()) == 0
    halves = len(room.seen)
    assert halves == 3 * room.print.next and 500 <= halves <= 503
    room.emulated.clock.sleep(5 * SECOND)
    assert room.run() is PrintState.COMPLETE
    assert (np.diff(angles) >= 0).all(), "a vial is never turned back"
    assert (room.slots() == 6).all() and not room.astray().any()
    assert room.told.shown["slot"].tolist() == list(range(720)) and not room.told.shown["dark"].any()


def test_another_host_goes_on_at_the_true_angle(tmp_path: Path) -> None:
    room = Room(tmp_path / "run", turns=2)
    room.frames.happens = {500: room.print.pause}
    assert room.print.run() is PrintState.PAUSED
    first = room.print.next
    room.folder.close()
    room.machines = room.emulated.machines()
    room.folder = RunFolder.again(room.path)
    room.print = Print(room.player(), room.folder)
    assert room.print.run(first) is PrintState.COMPLETE
    assert (room.slots() == 6).all() and not room.astray().any()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 5))])
def test_whatever_happens_no_slot_is_missing_and_the_record_tells_what_the_resin_saw(tmp_path: Path, seed: int) -> None:
    room, chance = Room(tmp_path / "run", turns=2, added=3), np.random.default_rng(seed)
    room.print = Print(room.player(), room.folder, limits=SafetyLimits(budget=2.0))
    room.emulated.screen.hitches = dict(zip(chance.integers(540, 1700, 5).tolist(), [1, 2, 3, 1, 2], strict=True))
    late, until = set(chance.integers(0, 360, 4).tolist()), int(chance.integers(300, 1300))
    room.frames.ready = lambda number: number not in late or room.frames.asked > until
    room.frames.happens = dict.fromkeys(chance.integers(1, 2400, 3).tolist(), room.print.pause)
    for _ in range(4):
        if room.print.run() is PrintState.COMPLETE:
            break
    assert room.print.states.state is PrintState.COMPLETE
    shown, slot = room.told.shown, int(room.schedule.on[0]) // 3
    assert shown["slot"].tolist() == list(range(len(shown)))
    assert (room.slots() >= 6).all() and 0 <= room.slots().sum() - 6 * 360 <= 2 * 9, "only what the screen repeated"
    assert shown["on_time"][shown["dark"] == 0].sum() == slot * room.slots().sum()


# ---- what fits ---------------------------------------------------------------------------------------------
def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    room = Room(tmp_path / "run")
    mirrors = MirrorTiming(pixels=(4, 1), row_bytes=8)

    def refused(schedule: Schedule, display: HdmiTiming = DISPLAY) -> None:
        SpinningPlayer(schedule, display, room.machines, room.frames)

    with pytest.raises(BadInput, match="in mm"):
        refused(web(9, advance=0.1, speed=0.8, engines=mirrors))
    with pytest.raises(BadInput, match="2 engines"):
        refused(vial(360, speed=40, display=DISPLAY, power=(1.0, 0.5)))
    for other in (HdmiTiming(), HdmiTiming(pixels=(4, 1), bits=7), HdmiTiming(pixels=(4, 1), latency=2)):
        with pytest.raises(WrongDevice, match="rig's file"):
            refused(vial(360, speed=40 if other.bits == 8 else 60, display=other), other)
    linear = ZaberStage(room.machines.stage._link, MICROSTEPS, "mm")  # type: ignore[attr-defined]
    room.machines.stage = linear
    with pytest.raises(BadInput, match="moves in mm"):
        refused(room.schedule)
