"""The emulators against golden bytes and known physics, without the drivers."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vamgpu.hosts.emulators.array import ArrayModel, Shown
from vamgpu.hosts.emulators.camera import EmulatedCamera, ResinModel, ResinScene, Sensor
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController, line_check
from vamgpu.hosts.emulators.dmd import FakeAlp
from vamgpu.hosts.emulators.glass import LensModel
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.line import Cable
from vamgpu.hosts.emulators.screen import EmulatedScreen, Slot
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.emulators.track import Track

MILLI, SECOND = 1_000_000, 1_000_000_000


def _ask(lens: EmulatedLens, frame: str | bytes, now: int) -> bytes:
    lens.receive(bytes.fromhex(frame) if isinstance(frame, str) else frame, now)
    return lens.take(now + 50 * MILLI)


def test_the_clock_runs_machines_in_order_of_time() -> None:
    class Machine:
        def __init__(self, times: list[int]) -> None:
            self.times, self.acted = times, []

        def due(self) -> int | None:
            return self.times[0] if self.times else None

        def advance(self, now: int) -> None:
            while self.times and self.times[0] <= now:
                order.append((self.times.pop(0), clock.now()))

    order: list[tuple[int, int]] = []
    clock = VirtualClock()
    clock.attach(Machine([5, 20, 30]))
    clock.attach(Machine([1, 20, 25]))
    clock.sleep_until(26)
    assert order == [(1, 1), (5, 5), (20, 20), (20, 20), (25, 25)] and clock.now() == 26
    clock.sleep_until(3)
    assert clock.now() == 26
    clock.sleep(4)
    assert order[-1] == (30, 30)


# the lens driver


def test_lens_golden_bytes() -> None:
    lens = EmulatedLens(celsius=27.125)
    assert _ask(lens, b"Start", 0) == b"Ready\r\n"
    assert _ask(lens, "48 00 36", MILLI)[:2] == b"HA"
    assert _ask(lens, "54 41 fe f0", 200 * MILLI) == bytes.fromhex("54 41 00 01 b2 a4 15 0d 0a")
    assert _ask(lens, "41 77 05 7a 26 95", 300 * MILLI) == b""
    assert _ask(lens, "41 72 00 00 b4 27", 400 * MILLI) == bytes.fromhex("41 05 7a d2 a7 0d 0a")
    assert _ask(lens, "41 72 00 00 b4 28", 500 * MILLI) == bytes.fromhex("45 01 f3 50 0d 0a")
    assert _ask(lens, "4d 4d 41 65 77", 600 * MILLI)[:4] == b"MMA\x01"
    assert _ask(lens, b"Start", 700 * MILLI) == b"Ready\r\n"
    assert _ask(lens, "41 72 00 00 b4 27", 800 * MILLI)[1:3] == b"\0\0", "the handshake resets the current"


def test_lens_errors() -> None:
    lens = EmulatedLens()
    assert _ask(lens, b"?!", 0)[:2] == b"E\x03"
    assert _ask(lens, b"RESET", 100 * MILLI)[:2] == b"E\x03"
    old = EmulatedLens(legacy=True)
    assert _ask(old, "41 72 00 00 b4 28", 0) == b"N\r\n"
    blind = EmulatedLens(sensor=False)
    assert _ask(blind, "4d 77 43 41 56 76", 0)[:2] == b"E\x04"
    assert _ask(blind, "54 43 41 b0 d0", 100 * MILLI)[3:5] == b"\x0f\xff"
    half = EmulatedLens()
    half.receive(b"Aw\x05", 0)
    assert half.due() == 20 * MILLI
    half.advance(20 * MILLI)
    assert half.take(50 * MILLI)[:2] == b"E\x01"
    assert _ask(half, "41 77 05 7a 26 95", 60 * MILLI) == b"" and half.current_code == 1402


def _focusing(**options: object) -> EmulatedLens:
    lens = EmulatedLens(LensModel(**options))  # type: ignore[arg-type]
    _ask(lens, "50 77 54 41 02 d0 01 40 33 c1", 0)
    _ask(lens, "4d 77 43 41 56 76", 100 * MILLI)
    return lens


def test_the_lens_settles_as_a_damped_oscillator() -> None:
    lens = _focusing(natural_hz=150.0, damping=0.5)
    start = SECOND
    lens.receive(bytes.fromhex("50 77 44 41 04 b0 00 00 31 a7"), start)
    times = np.arange(0, 40 * MILLI, 10_000)
    power = np.array([lens.power(start + int(t)) for t in times])
    t, omega = times * 1e-9, 2 * np.pi * 150
    y = v = 0.0
    wanted = []
    for _ in t:
        wanted.append(y)
        for _ in range(20):
            step = 10e-6 / 20
            a = omega**2 * (1 - y) - 2 * 0.5 * omega * v
            v += step * a
            y += step * v
    assert np.abs(power - wanted).max() < 2e-3
    overshoot = np.exp(-np.pi * 0.5 / np.sqrt(1 - 0.25))
    assert power.max() == pytest.approx(1 + overshoot, abs=1e-3)
    assert lens.power(start + SECOND) == pytest.approx(1.0, abs=1e-9)
    lens.receive(bytes.fromhex("50 77 44 41 06 40 00 00 30 2c"), start + SECOND)
    assert lens.power(start + 3 * MILLI) == power[300], "the past does not change"


def test_current_mode_drifts_with_temperature_and_focal_power_mode_does_not() -> None:
    lens = EmulatedLens(LensModel(offset=0.0))
    lens.warm(35.0, 0)
    assert lens.power(SECOND) == pytest.approx(0.67)
    lens = _focusing()
    lens.receive(bytes.fromhex("50 77 44 41 04 b0 00 00 31 a7"), SECOND)
    lens.warm(35.0, 2 * SECOND)
    assert lens.power(3 * SECOND) == pytest.approx(1.0)


def test_a_cable_takes_the_time_of_its_bytes() -> None:
    lens = _focusing()
    cable = Cable(lens, 38400)
    cable.send(bytes.fromhex("50 77 44 41 04 b0 00 00 31 a7"), SECOND)
    assert cable.due() == SECOND + 260_417
    cable.advance(SECOND + 2_604_169)
    assert lens.power_code != 1200
    cable.advance(SECOND + 2_604_170)
    assert lens.power_code == 1200


# tracks


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 3000), st.floats(-500, 500)), min_size=1, max_size=6))
def test_tracks_do_not_jump_and_keep_to_their_acceleration(changes: list[tuple[int, float]]) -> None:
    track, now = Track(acceleration=800.0), 0
    for wait_ms, velocity in changes:
        now += wait_ms * MILLI
        track.run(now, velocity)
    times = np.linspace(0, now + 2 * SECOND, 4001).astype(np.int64)
    x = np.array([track.position(int(t)) for t in times])
    v = np.array([track.velocity(int(t)) for t in times])
    step = np.diff(times) * 1e-9
    assert (np.abs(np.diff(v)) <= 800.0 * step + 1e-6).all()
    assert np.abs(np.diff(x) - step * (v[1:] + v[:-1]) / 2).max() < 800.0 * step.max() ** 2
    assert v[-1] == changes[-1][1]


@settings(max_examples=60, deadline=None)
@given(st.floats(-1000, 1000), st.floats(1, 500))
def test_moves_end_where_they_should_at_rest(target: float, speed: float) -> None:
    track = Track(acceleration=800.0)
    track.go(0, target, speed)
    end = track.settled_at
    assert track.position(end) == target and track.velocity(end) == 0.0
    times = np.linspace(0, end, 500).astype(np.int64)
    v = [abs(track.velocity(int(t))) for t in times]
    assert max(v) <= speed * (1 + 1e-6) + 1e-6


@settings(max_examples=60, deadline=None)
@given(st.floats(1, 5000), st.floats(1, 900))
def test_the_time_a_target_is_reached_is_the_first(target: float, speed: float) -> None:
    track = Track(acceleration=800.0)
    track.run(MILLI, speed)
    at = track.reaches(target, 0)
    assert at is not None
    assert track.position(at) >= target - 1e-5 * speed and track.position(at - 1000) < target


# the mirror array, through its C functions


def _array(clock: VirtualClock, **options: object) -> tuple[FakeAlp, ctypes.c_uint32, list[Shown]]:
    fake = FakeAlp(clock, ArrayModel(height=4, width=16, **options))  # type: ignore[arg-type]
    device = ctypes.c_uint32()
    assert fake.library.AlpDevAlloc(0, 0, ctypes.byref(device)) == 0
    shown: list[Shown] = []
    fake.on_shown = shown.append
    return fake, device, shown


def _sequence(fake: FakeAlp, device: ctypes.c_uint32, bits: int, pictures: np.ndarray, packed: bool) -> int:
    sequence = ctypes.c_uint32()
    alp = fake.library
    assert alp.AlpSeqAlloc(device, bits, len(pictures), ctypes.byref(sequence)) == 0
    if packed:
        assert alp.AlpSeqControl(device, sequence, 2110, 2) == 0
    assert alp.AlpSeqPut(device, sequence, 0, len(pictures), pictures.ctypes.data) == 0
    return sequence.value


def test_mirrors_show_bytes_and_packed_planes_alike() -> None:
    levels = np.random.default_rng(1).integers(0, 256, (3, 4, 16), dtype=np.uint8)
    planes = np.stack([np.packbits(levels >> (7 - b) & 1, axis=-1) for b in range(8)], axis=1)
    for pictures, packed in ((levels, False), (np.ascontiguousarray(planes), True)):
        clock = VirtualClock()
        fake, device, shown = _array(clock)
        sequence = _sequence(fake, device, 8, pictures, packed)
        assert fake.library.AlpSeqTiming(device, sequence, 10_000, 12_000, 0, 0, 0) == 0
        assert fake.library.AlpProjStart(device, sequence) == 0
        clock.sleep(SECOND)
        assert [each.starts[0] for each in shown] == [0, 12 * MILLI, 24 * MILLI]
        for each, wanted in zip(shown, levels, strict=True):
            light = sum(
                each.mirrors(plane, 16).astype(float) * (each.ends[plane] - each.starts[plane]) for plane in range(8)
            )
            assert np.abs(light / (10 * MILLI) - wanted / 255).max() < 1e-6


def test_memory_limits_and_states_are_the_librarys() -> None:
    fake, device, _ = _array(VirtualClock(), planes=20)
    alp, sequence, number = fake.library, ctypes.c_uint32(), ctypes.c_int32()
    assert alp.AlpSeqAlloc(device, 8, 3, ctypes.byref(sequence)) == 1007
    assert alp.AlpSeqAlloc(device, 8, 2, ctypes.byref(sequence)) == 0
    assert alp.AlpDevInquire(device, 2003, ctypes.byref(number)) == 0 and number.value == 4
    assert alp.AlpSeqTiming(device, sequence, 0, 3000, 0, 0, 0) == 1005, "eight bits take longer"
    assert alp.AlpProjStart(device, sequence) == 0
    assert alp.AlpSeqFree(device, sequence) == 1008
    assert alp.AlpDevFree(device) == 1002
    assert alp.AlpProjHalt(device) == 0
    assert alp.AlpSeqFree(device, sequence) == 0
    fake.removed = True
    assert alp.AlpDevInquire(device, 2003, ctypes.byref(number)) == 1012


def test_triggers_that_come_too_soon_are_missed_and_a_halt_cuts_the_picture() -> None:
    clock = VirtualClock()
    fake, device, shown = _array(clock)
    alp = fake.library
    assert alp.AlpProjControl(device, 2300, 2302) == 0 and alp.AlpDevControl(device, 2014, 1) == 0
    sequence = _sequence(fake, device, 8, np.full((4, 4, 16), 255, np.uint8), False)
    assert alp.AlpSeqTiming(device, sequence, 5000, 5000, 0, 0, 1000) == 0
    assert alp.AlpProjStart(device, sequence) == 0
    for at in (0, 3, 10, 20):
        clock.sleep_until(at * MILLI)
        fake.trigger(at * MILLI)
    clock.sleep_until(22 * MILLI)
    assert alp.AlpProjHalt(device) == 0
    assert fake.counts["missed"] == 1 and fake.counts["shown"] == 3
    assert [(each.starts[0], each.ends[-1]) for each in shown] == [
        (MILLI, 6 * MILLI),
        (11 * MILLI, 16 * MILLI),
        (21 * MILLI, 22 * MILLI),
    ]


def test_slave_mode_times_out_unless_told_not_to() -> None:
    clock = VirtualClock()
    fake, device, _ = _array(clock)
    alp, state = fake.library, ctypes.c_int32()
    assert alp.AlpProjControl(device, 2300, 2302) == 0
    sequence = _sequence(fake, device, 1, np.zeros((1, 4, 16), np.uint8), False)
    assert alp.AlpProjStart(device, sequence) == 0
    clock.sleep(2 * SECOND)
    assert alp.AlpProjInquire(device, 2400, ctypes.byref(state)) == 0 and state.value == 1201


def test_progress_is_36_bytes() -> None:
    fake, device, _ = _array(VirtualClock())
    words = (ctypes.c_uint32 * 10)(*[7] * 10)
    assert fake.library.AlpProjInquireEx(device, 2318, words) == 0
    assert words[8] == 1 and words[9] == 7, "nothing behind the structure is touched"


# the controller


class _Host:
    """Writes lines of its own making, so that the codec cannot hide a mistake."""

    def __init__(self) -> None:
        self.machine, self.clock, self.number = EmulatedController(), VirtualClock(), 0
        self.clock.attach(self.machine)
        self.lights: list[tuple[int, int]] = []
        self.triggers: list[int] = []
        self.frames: list[tuple[int, bytes]] = []
        self.machine.on_light = lambda channels, at: self.lights.append((channels, at))
        self.machine.on_trigger = self.triggers.append
        self.machine.on_lens = lambda frame, at: self.frames.append((at, frame))
        self.ask("hello")

    def ask(self, text: str, number: int | None = None) -> str:
        self.number = number if number is not None else self.number + 1
        body = f"{self.number} {text}".encode()
        self.machine.receive(body + b"*%04X\n" % line_check(body), self.clock.now())
        lines = self.machine.take(self.clock.now() + MILLI).split(b"\n")
        return next((line.decode()[:-5].split(" ", 1)[1] for line in lines if line[:1].isdigit()), "")

    def ready(self, lease_ms: int = 1000) -> None:
        assert self.ask(f"lease {lease_ms}") == "ok" and self.ask("arm") == "ok"


def test_light_needs_a_lease_and_goes_off_with_it() -> None:
    host = _Host()
    assert host.ask("light 1") == "no armed"
    assert host.ask("arm") == "no lease"
    host.ready(250)
    assert host.ask("light 3") == "ok"
    for _ in range(10):
        host.clock.sleep(200 * MILLI)
        assert host.ask("lease 250") == "ok"
    host.clock.sleep(SECOND)
    assert host.lights == [(3, 0), (0, 2250 * MILLI)]
    assert host.ask("light 1") == "no armed"
    assert host.ask("stat").startswith("ok fault") and host.ask("stat").endswith(" lease")


def test_an_open_interlock_closes_the_light() -> None:
    host = _Host()
    host.ready()
    host.ask("light 1")
    host.clock.sleep(5 * MILLI)
    host.machine.open_interlock(5 * MILLI)
    assert host.lights[-1] == (0, 5 * MILLI)
    host.ask("lease 1000")
    assert host.ask("arm") == "no interlock"


def test_a_line_sent_twice_acts_once_and_a_broken_one_not_at_all() -> None:
    host = _Host()
    host.ready()
    assert host.ask("row 0 1000 - 0 100 1") == "ok 255 1"
    assert host.ask("row 0 1000 - 0 100 1", host.number) == "ok 255 1"
    assert host.ask("row 0 1000 - 0 100 1") == "no order"
    host.machine.receive(b"9 light 1*0000\n", 0)
    assert host.machine.light == 0 and host.machine.take(MILLI).startswith(b"? ")


def test_rows_act_at_their_times_with_lens_trigger_and_light() -> None:
    host = _Host()
    host.ready()
    for i in range(4):
        host.ask(f"row {i} {10_000 * i + 1000} {1200 if i % 2 else '-'} 2000 3000 {1 + i % 2}")
    host.ask("end 4")
    host.ask("go")
    host.clock.sleep(SECOND // 2)
    assert host.triggers == [(10 * i + 3) * MILLI for i in range(4)]
    golden = bytes.fromhex("50 77 44 41 04 b0 00 00 31 a7")
    assert host.frames == [(11 * MILLI, golden), (31 * MILLI, golden)]
    on = [(10 * i + 3) * MILLI for i in range(4)]
    wanted = [entry for i, t in enumerate(on) for entry in ((1 + i % 2, t), (0, t + 3 * MILLI))]
    assert host.lights == wanted
    assert host.ask("stat").startswith("ok done 4 4 0 256")


def test_rows_by_steps_follow_the_web_wherever_it_is() -> None:
    host = _Host()
    host.ready()
    host.ask("mode steps")
    host.ask("ramp 1000")
    for i in range(5):
        host.ask(f"row {i} {100 * (i + 1)} - 0 1000 1")
    host.ask("go")
    host.ask("move 500000")
    host.clock.sleep(900 * MILLI)
    web = host.machine.web
    assert [web.position(at) for at in host.triggers] == pytest.approx([100, 200, 300], abs=1e-3)
    assert host.triggers[0] == pytest.approx(np.sqrt(0.2) * SECOND, abs=2000)


def test_a_row_that_comes_late_stays_dark() -> None:
    host = _Host()
    host.ready()
    host.ask("row 0 1000 - 0 100 1")
    host.ask("go")
    host.clock.sleep(20 * MILLI)
    host.ask("row 1 10000 - 0 100 1")
    host.clock.sleep(20 * MILLI)
    assert len([1 for channels, _ in host.lights if channels]) == 1 and len(host.triggers) == 2
    assert host.ask("stat").split()[4] == "1"


def test_stop_darkens_before_the_web_rests() -> None:
    host = _Host()
    host.ready()
    host.ask("ramp 1000")
    host.ask("move 100000")
    host.clock.sleep(SECOND)
    host.ready()
    host.ask("light 1")
    host.ask("stop")
    assert host.lights[-1] == (0, SECOND) and host.machine.web.velocity(SECOND) == 100
    assert host.machine.web.velocity(SECOND + 100 * MILLI) == 0


# the others


def test_the_stage_moves_as_it_says() -> None:
    stage = EmulatedStage(limit=100_000, acceleration=100_000.0)
    stage.receive(b"/1 1 set maxspeed 16384\n/1 1 move abs 20000\n/1 1 move abs 200000\n/1 1 nonsense\n", 0)
    lines = stage.take(MILLI).decode().split("\r\n")
    assert lines[0] == "@01 1 OK IDLE WR 0" and lines[1] == "@01 1 OK BUSY WR 0"
    assert lines[2].endswith("BADDATA") and lines[3].endswith("BADCOMMAND")
    assert stage.true_position(SECOND) == pytest.approx(10_000 * 1 - 500, rel=1e-3)
    stage.receive(b"/1 1 get pos\n", 4 * SECOND)
    assert stage.take(5 * SECOND) == b"@01 1 OK IDLE WR 20000\r\n"
    stage.receive(b"/01 1 05 get pos:00\n", 6 * SECOND)
    assert stage.take(7 * SECOND) == b"", "a wrong check sum is not answered"


def test_the_screen_lights_slots_one_refresh_later_in_exact_cadence() -> None:
    clock = VirtualClock()
    screen = EmulatedScreen(clock, (2, 3), 60, "GR", 8)
    slots: list[Slot] = []
    screen.on_slot = slots.append
    for k in range(3):
        frame = np.zeros((2, 3, 3), np.uint8)
        frame[..., 1], frame[..., 0] = 2 * k + 1, 2 * k + 2
        assert screen.show(frame) == k + 1
    clock.sleep_until(SECOND // 2)
    levels = [int(slot.levels[0, 0]) for slot in slots]
    assert levels[:6] == [1, 2, 3, 4, 5, 6] and set(levels[6:]) == {5, 6}, "a screen repeats what is not replaced"
    assert slots[0].number == 4 and slots[0].start == -(-4 * SECOND // 120)
    assert all(slot.end == after.start for slot, after in zip(slots, slots[1:], strict=False))
    assert screen.repeated > 20


def test_the_camera_is_repeatable_and_the_resin_shows_its_dose() -> None:
    def run(seed: int) -> list[np.ndarray]:
        clock = VirtualClock()
        scene = ResinScene((20, 30), ResinModel(critical=50.0, width=5.0))
        camera = EmulatedCamera(clock, scene, Sensor(bits=12), blur=1.0, seed=seed)
        pictures = []
        for _ in range(11):
            pictures.append(camera.grab())
            scene.deposit(10.0, 0, SECOND)
        return pictures

    first, again, other = run(1), run(1), run(2)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])
    means = np.array([picture.mean() for picture in first]) - 2
    assert (np.diff(means[:8]) > -1).all()
    assert means[-1] / means[0] == pytest.approx(9.0, rel=0.02) and means[5] / means[0] == pytest.approx(5.0, rel=0.02)
    assert first[0].dtype == np.uint16 and first[0].std() > 0
