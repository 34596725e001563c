"""The drivers against the emulators: over pseudo terminals, sockets and virtual ports, with faults on the line."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import vamgpu
from vamgpu.errors import (
    BadInput,
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceRefused,
    OutOfMemory,
    ProtocolError,
    WrongDevice,
)
from vamgpu.hosts.drivers import alp
from vamgpu.hosts.drivers.camera import Camera, FilePlayer, GenicamCamera
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd, PlaneStream, SlotTiming
from vamgpu.hosts.drivers.lamp import ControllerChannel, Lamp, PowerCurve
from vamgpu.hosts.drivers.lens import TunableLens
from vamgpu.hosts.drivers.projector import HdmiProjector, PygletWindow, Window
from vamgpu.hosts.drivers.scpi import LampSupply, PowerMeter
from vamgpu.hosts.drivers.stage import Stage
from vamgpu.hosts.drivers.standa import StandaStage
from vamgpu.hosts.drivers.wire import Wire, open_wire
from vamgpu.hosts.drivers.zaber import ZaberStage
from vamgpu.hosts.emulators.array import ArrayModel, Shown
from vamgpu.hosts.emulators.camera import EmulatedCamera
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.dmd import FakeAlp
from vamgpu.hosts.emulators.instruments import EmulatedMeter, EmulatedSupply
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.line import Cable, Faults, LineMachine
from vamgpu.hosts.emulators.ports import plug
from vamgpu.hosts.emulators.screen import EmulatedScreen, Slot
from vamgpu.hosts.emulators.servers import PtyServer, TcpServer
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.protocols import optotune as ld4
from vamgpu.hosts.protocols.controller import Row
from vamgpu.hosts.protocols.slots import THREE_OF_7, TWO_OF_8

MILLI, SECOND = 1_000_000, 1_000_000_000


def _wire(machine: LineMachine, clock: VirtualClock, faults: Faults | None = None, timeout_s: float = 0.1) -> Wire:
    return Wire(plug(machine, clock, timeout_s, faults=faults), "the machine")


# ports


def test_a_missing_machine_is_an_error_that_says_what_to_check() -> None:
    for open_it in (
        lambda: TunableLens.open("/dev/no-such-port"),
        lambda: Controller.open("/dev/no-such-port"),
        lambda: ZaberStage.open("socket://127.0.0.1:1", 100.0),
        lambda: PowerMeter.open("usbtmc:/dev/no-such-meter"),
    ):
        with pytest.raises(DeviceNotFound, match="check"):
            open_it()
    with pytest.raises(DeviceNotFound, match="ALP library"):
        Dmd.open("/no/such/library.so")
    with pytest.raises(BadInput, match="address"):
        open_wire("nonsense://x", "a machine")


def test_a_port_has_one_user() -> None:
    with PtyServer(EmulatedController()) as server:
        first = Controller.open(server.url)
        with pytest.raises(DeviceBusy, match="another program"):
            Controller.open(server.url)
        first.close()
        Controller.open(server.url).close()


def test_another_machine_on_the_port_is_told() -> None:
    with PtyServer(EmulatedController()) as server, pytest.raises(WrongDevice):
        TunableLens.open(server.url, timeout_s=0.05)
    with PtyServer(EmulatedLens()) as server, pytest.raises(WrongDevice):
        Controller.open(server.url, timeout_s=0.05)
    with TcpServer(EmulatedLens()) as server, pytest.raises(WrongDevice):
        ZaberStage.open(server.url, 100.0, timeout_s=0.1)


def test_no_driver_imports_what_it_does_not_use() -> None:
    code = (
        "import sys, pkgutil, importlib, vamgpu.hosts.drivers as d\n"
        "for m in pkgutil.iter_modules(d.__path__): importlib.import_module(d.__name__ + '.' + m.name)\n"
        "bad = {'serial', 'pyglet', 'harvesters', 'libximc', 'vamgpu.hosts.emulators'} & set(sys.modules)\n"
        "sys.exit(', '.join(bad) or 0)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(vamgpu.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# the lens


@pytest.mark.parametrize("server_of", [PtyServer, TcpServer])
def test_the_lens_over_a_terminal_and_a_socket(server_of: type[PtyServer] | type[TcpServer]) -> None:
    lens = EmulatedLens(stray=True, celsius=30.0)
    with server_of(lens) as server, TunableLens.open(server.url, firmware="A", timeout_s=0.1) as driver:
        assert driver.version == "1.9.1000.7" and driver.full_current_ma == 292.84
        found = driver.focal_power_mode(20, 45)
        assert (found.status, found.least, found.greatest) == (0, -1.5, 3.5)
        with driver.streaming():
            for diopters in (0.0, 1.0, 2.0):
                driver.set_power(diopters)
            with pytest.raises(DeviceError, match="streams"):
                driver.temperature()
        assert driver.power() == 2.0 and driver.temperature() == 30.0 and driver.status() == ()
        assert lens.handshakes == 1 and lens.settings == 3 and lens.memory_writes == 0


def test_the_lens_is_held_to_its_firmware_and_mode() -> None:
    clock = VirtualClock()
    with pytest.raises(WrongDevice, match="firmware type C"):
        TunableLens(_wire(EmulatedLens(firmware="C"), clock), "A")
    driver = TunableLens(_wire(EmulatedLens(), clock))
    with pytest.raises(DeviceError, match="focal_power_mode"):
        driver.set_power(1.0)
    with pytest.raises(BadInput, match="wears"):
        driver.ask(ld4.set_full_current(200.0))
    blind = TunableLens(_wire(EmulatedLens(sensor=False), clock))
    with pytest.raises(DeviceRefused, match="not compatible"):
        blind.focal_power_mode()
    with pytest.raises(DeviceRefused, match="sensor"):
        blind.temperature()


def test_faults_on_the_lens_line() -> None:
    clock, faults = VirtualClock(), Faults()
    lens = EmulatedLens()
    port = plug(lens, clock, 0.1, faults=faults)
    driver = TunableLens(Wire(port, "the lens driver"))
    driver.focal_power_mode()
    sent = faults._count["in"]
    faults.flip_in = frozenset({sent + 5})
    with pytest.raises(DeviceRefused, match="check sum"), driver.streaming():
        driver.set_power(1.0)
        clock.sleep(100 * MILLI)
    faults.drop_out = frozenset({faults._count["out"] + 3})
    with pytest.raises(ProtocolError, match="8 of the 9 bytes"):
        driver.temperature()
    assert driver.temperature() == 25.0, "the line recovers"
    faults.dead = True
    with pytest.raises(ProtocolError, match="did not answer"):
        driver.temperature()
    port.unplug()
    with pytest.raises(DeviceLost, match="gone"):
        driver.set_power(1.0)


def test_the_lens_settles_on_the_virtual_clock() -> None:
    clock, lens = VirtualClock(), EmulatedLens()
    driver = TunableLens(Wire(plug(lens, clock, baud=38400), "the lens driver"))
    driver.focal_power_mode()
    clock.sleep(100 * MILLI)
    start = clock.now()
    driver.set_power(1.0)
    assert clock.now() == start, "a setting is not waited for"
    clock.sleep(2_604_000)
    assert abs(lens.power(clock.now())) < 1e-6
    clock.sleep(5_000_170)
    assert abs(lens.power(clock.now()) - 1) < 1e-3


# the controller


def test_the_controller_over_a_terminal() -> None:
    machine = EmulatedController()
    with PtyServer(machine) as server, Controller.open(server.url, microsteps_per_mm=200.0) as driver:
        assert (driver.capacity, driver.channels) == (256, 2)
        with pytest.raises(DeviceRefused) as refused:
            driver.arm()
        assert refused.value.code == "lease"
        driver.lease(200)
        driver.arm()
        driver.light(True)
        assert driver.status().light == 1
        time.sleep(0.3)
        status = driver.status()
        assert (status.state, status.fault, status.light) == ("fault", "lease", 0)
        assert ("light", "off", "lease") in driver.poll()


def test_dropped_and_flipped_bytes_are_asked_for_again_and_act_once() -> None:
    for spoiled in ("drop_in", "flip_in", "drop_out", "flip_out"):
        for byte in range(0, 24):
            clock, faults, machine = VirtualClock(), Faults(), EmulatedController()
            driver = Controller(_wire(machine, clock, faults))
            way = "in" if spoiled.endswith("in") else "out"
            setattr(faults, spoiled, frozenset({faults._count[way] + byte}))
            for i in range(4):
                driver.row(Row(i, 1000 * i, 1000 + i, 0, 100))
            assert [row[0] for row in machine.rows] == [0, 1, 2, 3], (spoiled, byte)
            assert driver.status().free == 252


def test_a_dead_controller_is_lost() -> None:
    clock, faults = VirtualClock(), Faults()
    driver = Controller(_wire(EmulatedController(), clock, faults))
    faults.dead = True
    with pytest.raises(DeviceLost, match="3 tries"):
        driver.status()


def test_the_web_and_the_lamp() -> None:
    clock, machine = VirtualClock(), EmulatedController()
    driver = Controller(_wire(machine, clock), microsteps_per_mm=1000.0)
    driver.ramp(1.0)
    driver.move(0.8)
    clock.sleep(10 * SECOND)
    assert driver.position_mm() == pytest.approx(8.0 - 0.32, abs=2e-3)
    assert driver.status().speed == 800_000
    lamp = Lamp(ControllerChannel(driver, 1), PowerCurve((0.0, 0.5, 1.0), (0.0, 100.0, 160.0)))
    lamp.set_power(130.0)
    assert machine.powers == [65535, round(0.75 * 65535)]
    with pytest.raises(BadInput, match="mW"):
        lamp.set_power(200.0)
    with pytest.raises(BadInput):
        ControllerChannel(driver, 2)
    with pytest.raises(BadInput):
        PowerCurve((0.0, 1.0), (1.0, 1.0))


# the mirror array


def _dmd(**options: object) -> tuple[VirtualClock, FakeAlp, Dmd]:
    clock = VirtualClock()
    fake = FakeAlp(clock, ArrayModel(height=6, width=16, **options))  # type: ignore[arg-type]
    return clock, fake, Dmd(fake.library)


def _packed(levels: np.ndarray) -> np.ndarray:
    return np.stack([np.packbits(levels >> (7 - bit) & 1, axis=-1) for bit in range(8)], axis=1)


def test_two_sequences_stream_more_than_fits_one_a_trigger() -> None:
    clock, fake, dmd = _dmd(planes=64)
    levels = np.random.default_rng(0).integers(0, 256, (37, 6, 16), dtype=np.uint8)
    shown: list[Shown] = []
    fake.on_shown = shown.append
    dmd.slave()
    with pytest.raises(OutOfMemory, match="296 planes, and 64 are free"):
        dmd.sequence(37, 8)
    stream = PlaneStream(dmd, 4, 8, SlotTiming(5000, 5000))
    assert dmd.free_planes() == 0 and stream.limits().on_us == 5000
    put = 0
    for trigger in range(37):
        while put < 37 and stream.room():
            stream.put(_packed(levels[put : put + 4]))
            put += len(levels[put : put + 4])
        if trigger == 0:
            with pytest.raises(DeviceError, match="room"):
                stream.put(_packed(levels[:4]))
        fake.trigger(clock.now())
        assert stream.shown() == trigger + 1
        clock.sleep(10 * MILLI)
    assert fake.counts == {"shown": 37, "missed": 0, "empty": 0, "uploaded": 37, "upload_bytes": 37 * 8 * 12}
    for each, wanted in zip(shown, levels, strict=True):
        bits = [each.mirrors(plane, 16) << (7 - plane) for plane in range(8)]
        assert np.array_equal(sum(bits), wanted)
    assert stream.shown() == 37
    stream.close()
    assert dmd.free_planes() == 64


def test_what_does_not_fit_the_mirrors_is_refused() -> None:
    _, _, dmd = _dmd()
    sequence = dmd.sequence(2, 8)
    for wrong in (np.zeros((1, 8, 6, 3), np.uint8), np.zeros((1, 8, 6, 2)), np.zeros((1, 8, 6, 4), np.uint8)[..., ::2]):
        with pytest.raises(BadInput, match="packed pictures"):
            sequence.put(wrong)
    with pytest.raises(BadInput, match="do not fit"):
        sequence.put(np.zeros((2, 8, 6, 2), np.uint8), 1)
    with pytest.raises(DeviceRefused, match="least_picture_us=3760"):
        sequence.retime(SlotTiming(3000, 3000))


def test_the_mirror_arrays_failures_are_named() -> None:
    clock, fake, dmd = _dmd()
    with pytest.raises(DeviceBusy):
        Dmd(fake.library)
    with pytest.raises(DeviceNotFound):
        Dmd(FakeAlp(clock).library, serial=5)
    with pytest.raises(WrongDevice, match="6 x 16"):
        Dmd(FakeAlp(clock, ArrayModel(height=6, width=16)).library, size=(1080, 1920))
    with pytest.raises(DeviceNotFound, match="AlpDevAlloc"):
        Dmd(SimpleNamespace())
    fake.removed = True
    with pytest.raises(DeviceLost, match="unplugged"):
        dmd.progress()
    dmd.close()


def test_a_closed_mirror_array_floats_and_is_free_for_another() -> None:
    _, fake, dmd = _dmd()
    with dmd:
        dmd.slave()
        PlaneStream(dmd, 1, 1).put(np.zeros((1, 1, 6, 2), np.uint8))
    assert fake.floating and not fake.allocated
    dmd.close()


def test_the_libraries_numbers_have_32_bits() -> None:
    import ctypes

    assert ctypes.sizeof(alp.Progress) == 36
    kinds = {kind for types in alp.SIGNATURES.values() for kind in types}
    assert ctypes.c_long not in kinds or ctypes.sizeof(ctypes.c_long) == 4


def _hour() -> list[tuple[object, ...]]:
    """An hour of one picture a second on every machine, and all that was seen of it."""
    clock, fake, dmd = _dmd()
    lens, machine = EmulatedLens(), EmulatedController()
    driver = Controller(_wire(machine, clock))
    focus = TunableLens(_wire(lens, clock))
    focus.focal_power_mode()
    cable = Cable(lens, 38400)
    clock.attach(cable)
    machine.on_trigger, machine.on_lens = fake.trigger, cable.send
    seen: list[tuple[object, ...]] = []
    fake.on_shown = lambda shown: seen.append((shown.number, shown.starts, shown.ends, lens.power(shown.starts[0])))
    dmd.slave()
    stream = PlaneStream(dmd, 60, 8, SlotTiming(500_000, 500_000))
    pictures = np.zeros((60, 8, 6, 2), np.uint8)
    driver.lease(1000)
    driver.arm()
    driver.end(3600)
    row = 0
    while stream.shown() < 3600:
        while stream.room() and stream.queued < 3600:
            stream.put(pictures)
        while row < 3600 and row - stream.shown() < 200:
            driver.row(Row(row, 1_000_000 * row + 10_000, 1000 + row % 3 * 100, 7600, 500_000))
            row += 1
        if not seen and not machine.running:
            driver.go()
        driver.lease(1000)
        clock.sleep(900 * MILLI)
    driver.lease(1000)
    clock.sleep(900 * MILLI)
    assert driver.status().state == "done" and driver.status().late == 0 and fake.counts["missed"] == 0
    assert machine.intervals[-1][1] - machine.intervals[-1][0] == 500 * MILLI
    return seen


def test_an_hour_passes_in_seconds_and_twice_the_same() -> None:
    first = _hour()
    assert len(first) == 3600 and first == _hour()
    starts = [entry[1][0] for entry in first]  # type: ignore[index]
    assert set(np.diff(starts)) == {SECOND}, "no drift"
    assert [round(entry[3], 2) for entry in first[:3]] == [0.0, 0.5, 1.0]  # type: ignore[arg-type]


# stages, screens, cameras, instruments


def test_the_zaber_stage_over_a_socket() -> None:
    machine = EmulatedStage(rotary=True, acceleration=3_000_000.0)
    with TcpServer(machine) as server, ZaberStage.open(server.url, microsteps=1000.0) as stage:
        assert isinstance(stage, Stage)
        stage.move(36.0, 600.0)
        assert stage.busy()
        stage.wait()
        assert stage.position() == 36.0
        stage.run(40.0)
        time.sleep(0.1)
        stage.stop()
        stage.wait()
        assert stage.position() > 38.0
        with pytest.raises(DeviceRefused, match="BADCOMMAND"):
            stage.ask("dance")
        assert stage.true_speed(40.0) == pytest.approx(40.0, abs=1e-3)


def test_the_zaber_stage_stays_within_its_limits() -> None:
    clock = VirtualClock()
    machine = EmulatedStage(limit=100_000)
    stage = ZaberStage(_wire(machine, clock), 1000.0, "mm", pause=lambda s: clock.sleep(round(s * SECOND)))
    stage.home()
    with pytest.raises(DeviceRefused, match="BADDATA"):
        stage.move(200.0, 10.0)
    stage.move(50.0, 10.0)
    stage.wait()
    assert 5 * SECOND < clock.now() < 6 * SECOND and machine.true_position(clock.now()) == 50_000
    with pytest.raises(BadInput):
        ZaberStage(_wire(machine, clock), 0.0)


class _Ximc:
    """What of the maker's axis the driver calls."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.settings = SimpleNamespace(Speed=0, uSpeed=0)

    def __getattr__(self, name: str) -> object:
        def called(*arguments: object) -> object:
            self.calls.append((name, *arguments))
            if name == "get_move_settings":
                return self.settings
            if name == "get_position":
                return SimpleNamespace(Position=-12, uPosition=-128)
            return None

        return called


def test_the_standa_stage_counts_in_steps_and_fractions() -> None:
    axis = _Ximc()
    with StandaStage(axis, steps=80.0) as stage:
        assert isinstance(stage, Stage)
        assert stage.position() == pytest.approx(-12.5 / 80)
        stage.move(-1.00625, 2.003125)
        assert axis.calls[-1] == ("command_move", -80, -128)
        assert (axis.settings.Speed, axis.settings.uSpeed) == (160, 64)
        stage.run(-1.0)
        assert axis.calls[-1] == ("command_left",)
    assert axis.calls[-2:] == [("command_sstp",), ("close_device",)]


def test_the_projector_lights_pictures_in_the_slots_it_says() -> None:
    clock = VirtualClock()
    for layout, order, bits in ((TWO_OF_8, "GR", 8), (THREE_OF_7, "GRB", 7)):
        screen = EmulatedScreen(clock, (4, 5), 60, order, bits)
        slots: dict[int, Slot] = {}
        screen.on_slot = lambda slot, slots=slots: slots.update({slot.number: slot})
        assert isinstance(screen, Window)
        projector = HdmiProjector(screen, layout)
        assert projector.slots_per_s == 60 * layout.slots
        rng, sent = np.random.default_rng(2), {}
        for _ in range(5):
            pictures = list(rng.integers(0, 256, (layout.slots, 4, 5), dtype=np.uint8))
            first = projector.show(pictures)
            sent |= {first + i: picture for i, picture in enumerate(pictures)}
        clock.sleep(SECOND)
        for number, picture in sent.items():
            found = slots[number].levels / slots[number].top
            assert np.abs(found - picture / 255).max() <= (0 if bits == 8 else 0.5 / 127) + 1e-9
        with pytest.raises(BadInput, match="4 x 5"):
            projector.show([np.zeros((4, 4), np.uint8)] * layout.slots)
        projector.close()


def test_packages_that_are_not_there_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("pyglet", "harvesters", "harvesters.core", "libximc", "serial"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DeviceNotFound, match="pip install pyglet"):
        PygletWindow(1, (1080, 1920))
    with pytest.raises(DeviceNotFound, match="pip install harvesters"):
        GenicamCamera.open(tmp_path / "x.cti")
    with pytest.raises(DeviceNotFound, match="pip install libximc"):
        StandaStage.open("xi-com:///dev/ttyACM0", 80.0)
    with pytest.raises(DeviceNotFound, match="hardware"):
        open_wire("/dev/ttyUSB0", "a machine")


class _Harvester:
    """What of a harvester the driver calls."""

    def __init__(self, serials: list[str]) -> None:
        self.device_info_list = [SimpleNamespace(serial_number=serial) for serial in serials]
        self.log: list[str] = []
        self.exposure = SimpleNamespace(value=0.0)

    def update(self) -> None:
        self.log.append("update")

    def create(self, chosen: dict[str, str]) -> _Harvester:
        self.log.append(f"create {chosen['serial_number']}")
        return self

    def start(self) -> None:
        self.log.append("start")

    def stop(self) -> None:
        self.log.append("stop")

    def destroy(self) -> None:
        self.log.append("destroy")

    def reset(self) -> None:
        self.log.append("reset")

    @property
    def remote_device(self) -> SimpleNamespace:
        return SimpleNamespace(node_map=SimpleNamespace(ExposureTime=self.exposure))

    def fetch(self, timeout: float) -> _Harvester:
        if timeout < 1:
            raise TimeoutError("no picture")
        return self

    def __enter__(self) -> SimpleNamespace:
        part = SimpleNamespace(data=np.arange(6, dtype=np.uint8), height=2, width=3)
        return SimpleNamespace(payload=SimpleNamespace(components=[part]))

    def __exit__(self, *_: object) -> None:
        self.log.append("queue")


def test_the_genicam_camera() -> None:
    harvester = _Harvester(["A1", "B2"])
    with GenicamCamera(harvester, "B2") as camera:
        assert isinstance(camera, Camera)
        camera.expose(1500)
        assert harvester.exposure.value == 1500.0
        assert camera.grab().tolist() == [[0, 1, 2], [3, 4, 5]]
    assert harvester.log == ["update", "create B2", "start", "queue", "stop", "destroy", "reset"]
    with pytest.raises(DeviceNotFound, match="A1, B2"):
        GenicamCamera(_Harvester(["A1", "B2"]), "C3")
    with pytest.raises(DeviceLost, match="no picture"):
        GenicamCamera(_Harvester(["A1"]), timeout_s=0.5).grab()


def test_the_file_player_counts_as_people_do(tmp_path: Path) -> None:
    for number in (1, 2, 10):
        Image.fromarray(np.full((2, 3), number, np.uint8)).save(tmp_path / f"shot{number}.png")
    (tmp_path / "notes.txt").write_text("not a picture")
    player = FilePlayer(tmp_path)
    assert isinstance(player, Camera)
    assert [int(player.grab()[0, 0]) for _ in range(3)] == [1, 2, 10]
    with pytest.raises(DeviceError, match="all 3"):
        player.grab()
    again = FilePlayer(tmp_path, loop=True)
    assert [int(again.grab()[0, 0]) for _ in range(4)] == [1, 2, 10, 1]
    with pytest.raises(DeviceNotFound):
        FilePlayer(tmp_path / "none")
    assert isinstance(EmulatedCamera(VirtualClock(), lambda now: np.zeros((2, 2))), Camera)


def test_the_meter_and_the_supply() -> None:
    clock = VirtualClock()
    supply = EmulatedSupply()
    lamp = LampSupply(_wire(supply, clock), greatest_ma=800.0)
    meter = PowerMeter(_wire(EmulatedMeter(lambda now: 700 * supply.current * supply.output), clock), "pm400")
    assert meter.power_mw() == 0.0
    lamp.drive(0.5)
    lamp.on()
    assert lamp.is_on() and meter.power_mw() == pytest.approx(280.0)
    meter.wavelength(405)
    with pytest.raises(DeviceRefused, match="out of range"):
        meter.wavelength(2000)
    lamp.drive(1.0)
    with pytest.raises(DeviceRefused, match="no value"):
        meter.power_mw()
    with pytest.raises(BadInput):
        lamp.drive(1.1)
    lamp.close()
    assert not supply.output
    with pytest.raises(WrongDevice, match="ophir"):
        PowerMeter(_wire(EmulatedMeter(lambda now: 0.0), clock), "ophir")


def test_silence_and_nonsense_from_an_instrument() -> None:
    clock, faults = VirtualClock(), Faults()
    meter = PowerMeter(_wire(EmulatedMeter(lambda now: 1.0), clock, faults))
    faults.drop_out = frozenset({faults._count["out"] + 11})
    with pytest.raises(ProtocolError, match="number"):
        meter.power_mw()
    faults.dead = True
    with pytest.raises(DeviceLost, match="MEAS:POW"):
        meter.power_mw()
