"""The machines of three labs, from their rig files: opened, told and printed on to the byte, with what goes wrong."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from emulated_cube import EmulatedCube
from emulated_lightcrafter import EmulatedDlpc900
from emulated_steppers import EmulatedFirmware, EmulatedGrbl, EmulatedTic, EmulatedTmc2209
from servers import PtyServer
from tcp_server import TcpServer
from test_diode_laser import EmulatedLaser, laser_of
from test_planning import vial
from test_steppers import grbl_of, own_of, tic_of, tmc_of
from test_thorlabs import COUNTS, stage_of

from vamgpu.errors import BadInput, DeviceError, DeviceLost, DeviceNotFound, DeviceRefused, JobError, WrongDevice
from vamgpu.hosts.drivers import alp, projector
from vamgpu.hosts.drivers import dlpc350_protocol as dlpc350
from vamgpu.hosts.drivers import dlpc900_protocol as dlpc900
from vamgpu.hosts.drivers.icc import IccLens
from vamgpu.hosts.drivers.lightcrafter import LightCrafter
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.player.machines import StageMachines, VideoMachines
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import carry_out, plan, read_rig, rehearsal
from vamgpu.hosts.rigs.config import RigConfig, parse_rig
from vamgpu.hosts.rigs.connection import close, opened
from vamgpu.hosts.safety.interlock import InterlockOpen

RIGS = Path(__file__).parents[2] / "docs" / "rigs"
IMAGES = 60


def printed(rig: RigConfig, place: Path, speed: float = 40.0, put: Callable[[Any], None] = lambda stand: None) -> Any:
    """Print a turn on a rig's rehearsal, whose machines may be replaced; the rehearsal, and what its resin saw."""
    one = plan(vial(place / "job.vam", images=IMAGES), rig, rehearsed=True, turns=1, speed=speed)
    stand = rehearsal(one)
    put(stand)
    assert carry_out(one, stand.machines, place / "run")[0] is PrintState.COMPLETE
    return stand, stand.monitor.verdict()


def turning(stand: Any, stage: Any, machine: Any, per_degree: float) -> None:
    """Another machine turns the vial of a rehearsal."""
    stand.machines.stage = stage
    stand.emulated.recorder._position = lambda now: machine.track.position(now) / per_degree / (360.0 / IMAGES)


# ---- a Zaber stage that triggers Vialux mirrors ----------------------------------------------------------------------
EPFL = RIGS / "epfl.toml"


def test_mirrors_are_lit_for_their_duty(tmp_path: Path) -> None:
    for duty in (1.0, 0.4):
        lit: set[int] = set()

        def heard(stand: Any, lit: set[int] = lit) -> None:
            (mirrors,) = stand.emulated.alps
            time = mirrors._AlpSeqTiming
            mirrors._AlpSeqTiming = lambda stored, shown, *rest: lit.add(shown) or time(stored, shown, *rest)

        _, verdict = printed(read_rig(EPFL, [f"display.duty={duty}"]), tmp_path / str(duty), put=heard)
        assert verdict.frames == IMAGES and verdict.greatest < 1e-6 and verdict.beside < 1e-9
        assert lit - {0} == {round(min(duty, 0.98) * 150_000)}, "of 150 ms an angle"


def test_a_trigger_at_another_output_or_without_its_gate_gives_no_light(tmp_path: Path) -> None:
    for number, (wired, joined) in enumerate(((1, None), (2, 3))):

        def elsewhere(stand: Any, wired: int = wired, joined: int | None = joined) -> None:
            stand.emulated.stage.wired, stand.emulated.stage.joined = wired, joined

        with pytest.raises(InterlockOpen, match="mirrors counted 0"):
            printed(read_rig(EPFL), tmp_path / str(number), put=elsewhere)


def test_a_diode_laser_lights_the_mirrors_at_its_power(tmp_path: Path) -> None:
    machine = EmulatedLaser("obis")

    def put(stand: Any) -> None:
        clock, recorder = stand.emulated.clock, stand.emulated.recorder
        machine.on_lit = lambda lit: recorder.lamp(int(lit), clock.now())
        stand.machines.lamp = laser_of(machine, clock=clock)

    keys = ("driver=diode laser", "port=/dev/x", "kind=obis", "watts=0.2")
    rig = read_rig(EPFL, [f"light.{key}" for key in keys])
    _, verdict = printed(rig, tmp_path, put=put)
    assert verdict.frames == IMAGES and verdict.greatest < 1e-6 and verdict.beside < 1e-9
    assert not machine.lit and machine.watts == 0.2 and machine.received.count("SOUR:AM:STAT ON") == 1
    machine = EmulatedLaser("obis", locked=False)
    with pytest.raises(DeviceRefused, match="open interlock"):
        printed(rig, tmp_path / "open", put=put)


def test_an_alp_and_a_zaber_are_opened_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    mirrors = EmulatedAlp(VirtualClock(), ArrayModel(height=768, width=1024))
    monkeypatch.setattr(alp, "load", lambda path: mirrors.library)
    with TcpServer(EmulatedStage(rotary=True)) as server:
        settings = [f"motion.port={server.url}", "display.edge=falling", "display.synch=[2, 3]", "display.active=low"]
        machines = opened(read_rig(EPFL, settings))
        assert isinstance(machines, StageMachines) and machines.lamp is None
        assert mirrors.gates == {1: bytes(18), 2: b"\1\0\1" + bytes(15), 3: b"\1\0\1" + bytes(15)} | {
            1: b"\0\0\1" + bytes(15)
        }
        machines.mirrors[0].slave()
        assert not mirrors.rising
        close(machines)
        with pytest.raises(WrongDevice, match="768 x 1024 mirrors; expected 1080 x 1920"):
            opened(read_rig(EPFL, [*settings, "display.size=[1080, 1920]"]))
    assert not mirrors.allocated
    for wrong in ("motion.gate=2", "motion.output=5", "display.synch=[4]", "display.duty=0"):
        with pytest.raises(JobError):
            read_rig(EPFL, [wrong])


# ---- a projector on a Raspberry Pi, and a stepper on a board ---------------------------------------------------------
OPENCAL = RIGS / "opencal.toml"
BOARDS: dict[str, tuple[Any, Any, float, str]] = {
    "tic": (EmulatedTic, tic_of, 3200.0 / 360.0, 'driver = "tic"'),
    "tmc2209": (lambda: EmulatedTmc2209(fast=0.97), tmc_of, 51200 / 360, 'driver = "tmc2209"'),
    "grbl": (EmulatedGrbl, grbl_of, 1.0, 'driver = "grbl"'),
    "text": (EmulatedFirmware, own_of, 3200.0 / 360.0, 'driver = "text"'),
}


@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize("speed", (pytest.param(6.0, marks=pytest.mark.slow), 60.0))
def test_a_stepper_turns_a_vial_before_a_projector(board: str, speed: float, tmp_path: Path) -> None:
    made, stage_on, per_degree, _ = BOARDS[board]
    machine = made()

    def put(stand: Any) -> None:
        turning(stand, stage_on(machine, stand.emulated.clock), machine, per_degree)

    if board == "grbl":
        machine.settings[110] = 7200
    stand, verdict = printed(read_rig(OPENCAL), tmp_path, speed, put)
    assert verdict.frames == IMAGES and verdict.greatest < 0.03, verdict
    assert stand.emulated.screen.order == "B"
    assert not stand.emulated.screen._frame.any(), "black at its end"


def test_only_blue_carries_the_frame(tmp_path: Path) -> None:
    seen: list[Any] = []

    def put(stand: Any) -> None:
        show = stand.emulated.screen.show
        stand.emulated.screen.show = lambda frame: seen.append(frame.max(axis=(0, 1)).tolist()) or show(frame)

    printed(read_rig(OPENCAL), tmp_path, put=put)
    assert max(blue for _, _, blue in seen) > 0 and all(red == green == 0 for red, green, _ in seen)
    with pytest.raises(JobError, match="the one color that has light"):
        read_rig(OPENCAL, ['display.order=["blue", "red"]'])


def test_a_stepper_that_stops_by_itself_ends_the_print(tmp_path: Path) -> None:
    machine = EmulatedTic()

    def put(stand: Any) -> None:
        turning(stand, tic_of(machine, stand.emulated.clock), machine, 3200.0 / 360.0)
        show, count = stand.machines.projector.show, iter(range(10**6))

        def stopping(frames: Any) -> int:
            if any(frame.any() for frame in frames) and next(count) == 120:
                machine.track.run(stand.emulated.clock.now(), 0.0)
            return show(frames)

        stand.machines.projector.show = stopping

    with pytest.raises((InterlockOpen, DeviceError), match="off position|pose"):
        printed(read_rig(OPENCAL), tmp_path, put=put)


class UsbTic:
    """libusb's device of a Tic: its control transfers."""

    def __init__(self, tic: EmulatedTic, clock: VirtualClock) -> None:
        self.tic, self.clock, self.configured = tic, clock, False
        self.transfers: list[tuple[int, ...]] = []

    def set_configuration(self) -> None:
        self.configured = True

    def ctrl_transfer(self, kind: int, command: int, value: int, index: int, size: int) -> bytes:
        self.transfers.append((kind, command, value, index, size))
        if kind == 0xC0:
            self.tic.receive(bytes([command, index, size]), self.clock.now())
            self.clock.sleep(1_000_000)
            return self.tic.take(self.clock.now())
        self.tic._act(bytes([command]) + coded(value | index << 16 if command >= 0xE0 else 0), self.clock.now())
        return b""


def coded(value: int) -> bytes:
    """The five data bytes of a serial command."""
    raw = value.to_bytes(4, "little")
    return bytes([sum((byte >> 7) << place for place, byte in enumerate(raw)), *(byte & 0x7F for byte in raw)])


def test_a_tic_on_usb_is_opened_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    core: Any = pytest.importorskip("usb.core", reason='pip install "vamgpu[tic]"')
    device, asked = UsbTic(EmulatedTic(), VirtualClock()), []
    monkeypatch.setattr(core, "find", lambda **keys: asked.append(keys) or device)
    monkeypatch.setattr("usb.util.dispose_resources", lambda one: setattr(one, "configured", False))
    monkeypatch.setattr(projector, "PygletWindow", lambda *_: SimpleNamespace(close=lambda: None, size=(1080, 1920)))
    machines = opened(read_rig(OPENCAL, ["motion.port=usb:00349871"]))
    assert isinstance(machines, VideoMachines) and asked == [{"idVendor": 0x1FFB, "serial_number": "00349871"}]
    machines.stage.run(40.0)
    assert device.transfers[-1] == (0x40, 0xE3, 3_555_556 & 0xFFFF, 3_555_556 >> 16, 0)
    assert machines.stage.position() == 0.0
    assert device.transfers[-2:] == [(0x40, 0x8C, 0, 0, 0), (0xC0, 0xA1, 0, 0x22, 4)]
    close(machines)
    assert device.transfers[-1][1] == 0x86 and not device.configured
    monkeypatch.setattr(core, "find", lambda **keys: None)
    with pytest.raises(DeviceNotFound, match="no Tic on USB"):
        opened(read_rig(OPENCAL))


# ---- a LightCrafter, a motion cube and a lens on an ICC --------------------------------------------------------------
CRAFTER = RIGS / "lightcrafter_kcube.toml"


def test_a_dlpc900_to_the_byte() -> None:
    assert b"\0" + dlpc350.frame(0x1100, sequence=0x11, read=True)[:6] == bytes.fromhex("00 c0 11 02 00 00 11")
    device = EmulatedDlpc900()
    pauses: list[float] = []
    with LightCrafter(device, pause=pauses.append, dlpc=dlpc900.DLPC900) as box:
        box.show_video((1, 0, 2), 8, 5478, 5478, "blue")
        assert device.sent[1:] == [
            (0x1A24, b"\0"), (0x1A1B, b"\0"), (0x1A00, b"\x08"), (0x1A01, b"\1"), (0x1A1B, b"\2"),
            (0x1A34, bytes.fromhex("00 00 66 15 00 cf 00 00 00 00 00 00")),  # green, after the vertical blanking
            (0x1A34, bytes.fromhex("01 00 66 15 00 4f 00 00 00 00 00 40")),  # red
            (0x1A34, bytes.fromhex("02 00 66 15 00 4f 00 00 00 00 00 80")),  # blue
            (0x1A31, bytes.fromhex("03 00 00 00 00 00")), (0x1A24, b"\2"),
        ]  # fmt: skip
        assert pauses and not device.lit
        assert (
            dlpc900.definition(0, 1, 7, 5478, 4)[5] == 0xCD and dlpc900.definition(0, 1, 7, 5478, 4)[10:] == b"\0\x08"
        )
        box.drive(blue=0.5)
        assert device.settings[dlpc350.LED_CURRENTS] == bytes([0, 0, 128]), "255 is the greatest current"
        box.on()
        assert device.lit
    assert not device.lit and device.closed


def test_what_a_dlpc900_does_not_do_is_told() -> None:
    box = LightCrafter(EmulatedDlpc900(signal=False), pause=lambda seconds: None, dlpc=dlpc900.DLPC900)
    with pytest.raises(DeviceLost, match="has not reached a locked video signal in 15.0 s; check its video cable"):
        box.show_video((1, 0, 2), 8, 5478, 5478, "blue")
    device = EmulatedDlpc900()
    box = LightCrafter(device, pause=lambda seconds: None, dlpc=dlpc900.DLPC900)
    steps = dlpc900.video((1,), 8, 5478, 5478, 4)
    short = [
        step._replace(data=(step.data or b"")[:-1]) if step.command == dlpc900.DEFINITION else step for step in steps
    ]
    box._dlpc = dlpc900.DLPC900._replace(video=lambda *_: tuple(short))
    with pytest.raises(DeviceRefused, match="invalid: parameter"):
        box.show_video((1,), 8, 5478, 5478, "blue")
    assert device.settings[dlpc350.DISPLAY] == b"\0", "nothing is shown"
    for wrong in (((1,), 8, 4000, 4000), ((1,), 9, 5000, 5000), ((1, 0, 2), 8, 5600, 5600), ((1,), 8, 5000, 6000)):
        with pytest.raises(BadInput):
            LightCrafter(EmulatedDlpc900(), dlpc=dlpc900.DLPC900).show_video(*wrong, "blue")
    with pytest.raises(JobError, match="cannot be shown for 3627 us"):
        read_rig(CRAFTER, ["display.refresh=90 Hz"])


class IccBoard:
    """The maker's package for an ICC, as its users call it; ``power`` is what the lens has."""

    def __init__(self, device: int = 5, listed: bool = False) -> None:
        self.device, self.open, self.power, self.celsius = device, True, 0.0, 31.5
        self.input = ""
        wrap = (lambda value: [value]) if listed else (lambda value: value)
        self.MiscFeatures = SimpleNamespace(GetDeviceType=lambda channel: self.device if channel == 0 else 0)
        self.channel = [SimpleNamespace(
            StaticInput=SimpleNamespace(
                SetAsInput=lambda: setattr(self, "input", "static"), SetFocalPower=self._set,
                GetFocalPower=lambda: wrap(self.power)),
            LensCompensation=SimpleNamespace(GetMinDiopter=lambda: wrap(-2.0), GetMaxDiopter=lambda: wrap(4.0)),
            TemperatureManager=SimpleNamespace(GetDeviceTemperature=lambda: wrap(self.celsius)),
        )]  # fmt: skip

    def _set(self, power: float) -> None:
        if not self.open:
            raise ValueError("port is closed")
        self.power = power

    def disconnect(self) -> None:
        self.open = False


def test_a_lens_on_an_icc() -> None:
    for listed in (False, True):
        board = IccBoard(listed=listed)

        def connect(board: IccBoard = board) -> IccBoard:
            board.open = True
            return board

        with IccLens(connect) as lens:
            assert board.input == "static" and (lens.least, lens.greatest) == (-2.0, 4.0) and not lens.status()
            lens.set_power(1.25)
            assert board.power == lens.power() == 1.25 and lens.temperature() == 31.5
            with pytest.raises(BadInput, match="-2 to 4 dpt"):
                lens.set_power(4.5)
            assert lens.inspect() == 1.25
            board.power, board.input = 0.0, ""
            with pytest.raises(DeviceError, match="is at 0.000 dpt; expected 1.250"):
                lens.inspect()
            lens.revive()
            assert board.power == 1.25 and board.input == "static"
            board.power, board.open = 0.0, False  # it was unplugged
            lens.revive()
            assert board.open and board.power == 1.25
            board.device = 0
            with pytest.raises(DeviceRefused, match="sensor missing"):
                lens.inspect()
            assert lens.status() == ("lens or sensor missing",)
            board.open = False
            with pytest.raises(DeviceError, match="failed in a focal power"):
                lens.set_power(1.0)
        assert not board.open
    with pytest.raises(DeviceNotFound, match="channel 1 of the ICC has no lens"):
        IccLens(IccBoard, 1)


def hid_of(device: Any, asked: list[Any]) -> Any:
    device.open = lambda *which: asked.append(which)
    return SimpleNamespace(device=lambda: device)


def test_a_lightcrafter_a_cube_and_a_lens_are_opened_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    device, board, asked = EmulatedDlpc900(), IccBoard(), []
    monkeypatch.setitem(sys.modules, "hid", hid_of(device, asked))
    monkeypatch.setitem(sys.modules, "optoICC", SimpleNamespace(connect=lambda port: asked.append(port) or board))
    window = SimpleNamespace(size=(1080, 1920), rate_hz=60.0, close=lambda: None)
    monkeypatch.setattr(projector, "PygletWindow", lambda *_: window)
    monkeypatch.setattr("vamgpu.hosts.drivers.thorlabs.open_wire", open_without_rtscts)
    with PtyServer(EmulatedCube()) as server:
        rig = read_rig(CRAFTER, [f"motion.port={server.url}"])
        machines = opened(rig)
        assert isinstance(machines, VideoMachines) and isinstance(machines.lamp, LightCrafter)
        assert asked == ["/dev/ttyACM0", (0x0451, 0xC900, None)] and board.power == 0.5
        assert machines.projector.layout.channels == (1, 0, 2) and len(device.patterns) == 3 and not device.lit
        close(machines)
        assert device.closed and not board.open
        with pytest.raises(WrongDevice, match="guarantees -2 to 4 dpt"):
            opened(read_rig(CRAFTER, [f"motion.port={server.url}", "lens.highest=5"]))
        assert not board.open
    with pytest.raises(JobError, match="host"):
        read_rig(CRAFTER, ["lens.controlled_by=controller"])
    with pytest.raises(JobError, match='expected controlled_by = "host"'):
        parse_rig(rig.text.replace("optotune-icc", "optotune").replace("channel = 0\n", "") + CONTROLLER)


CONTROLLER = '\n[controller]\nport = "/dev/x"\n'


def open_without_rtscts(port: str, name: str, baud: int, timeout_s: float, rtscts: bool) -> Any:
    from vamgpu.hosts.drivers.wire import open_wire

    return open_wire(port, name, baud, timeout_s)


def test_the_leds_light_three_frames_of_each_video_frame(tmp_path: Path) -> None:
    cube, device = EmulatedCube(), EmulatedDlpc900()

    def put(stand: Any) -> None:
        clock, recorder = stand.emulated.clock, stand.emulated.recorder
        turning(stand, stage_of(cube, clock), cube, COUNTS)
        recorder.lamp(0, clock.now())
        device.on_lit = lambda lit: recorder.lamp(int(lit), clock.now())
        display = stand.machines.projector
        box = LightCrafter(device, pause=lambda seconds: clock.sleep(round(seconds * 1e9)), dlpc=dlpc900.DLPC900)
        box.show_video(display.layout.channels, 8, 5478, 5478, ("blue",))
        stand.machines.lamp = box

    stand, verdict = printed(read_rig(CRAFTER), tmp_path, put=put)
    assert verdict.frames == IMAGES and verdict.greatest < 0.02 and not device.lit
    assert stand.emulated.screen.order == "GRB" and stand.emulated.screen.share == pytest.approx(
        3 * 5478e-6 * 60, abs=2e-4
    )
