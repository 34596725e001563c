"""Parts of real rigs that measure the motion, make their own light, or watch: told as the rig file says."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from emulated_lightcrafter import EmulatedLightCrafter
from servers import PtyServer

from vamgpu.errors import DeviceLost, DeviceNotFound, JobError
from vamgpu.hosts.drivers import camera, micromanager, projector, stepper
from vamgpu.hosts.drivers import dlpc350_protocol as dlpc350
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.lightcrafter import LightCrafter
from vamgpu.hosts.drivers.stepper import GpioIndex, StepperStage
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.player.machines import MirrorMachines, VideoMachines
from vamgpu.hosts.rigs.config import RigConfig, parse_rig
from vamgpu.hosts.rigs.connection import close, opened
from vamgpu.hosts.rigs.displays import AlpDisplay
from vamgpu.hosts.rigs.guarantees import guarantees

HEAD = '[rig]\nname = "lab"\nmachine = "vial"\n'
MOTOR = '[motion]\ndriver = "controller"\nmicrosteps = 1000\n'
ZABER = '[motion]\ndriver = "zaber"\nport = "{}"\nmicrosteps = 1000\n'
STEPPER = '[motion]\ndriver = "stepper"\nmicrosteps = 80.0\n'
ALP = '[display]\ndriver = "alp"\nlibrary = "libalp.so"\n'
VIDEO = '[display]\ndriver = "video"\n'
CRAFTER = '[display]\ndriver = "lightcrafter"\nsize = [8, 12]\ncurrent = 0.5\n'


def feedback(driver: str, **keys: Any) -> str:
    return f'[[feedback]]\ndriver = "{driver}"\n' + "".join(f"{name} = {value}\n" for name, value in keys.items())


def rig(*tables: str, port: str = "/dev/x") -> RigConfig:
    return parse_rig(HEAD + f'[controller]\nport = "{port}"\n' + "".join(tables))


@pytest.fixture
def line() -> Iterator[str]:
    with PtyServer(EmulatedController()) as server:
        yield server.url


def test_the_controller_is_told_what_measures(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(AlpDisplay, "open", lambda self: SimpleNamespace(close=lambda: None))
    told: list[tuple[Any, ...]] = []
    ask = Controller.ask
    monkeypatch.setattr(Controller, "ask", lambda self, *words: told.append(words) or ask(self, *words))
    encoder, index = feedback("encoder", counts=-500.0, tolerance=0.05), feedback("index", tolerance=0.02)
    config = rig(MOTOR, ALP, encoder, index, port=line)
    machines = opened(config)
    assert isinstance(machines, MirrorMachines)
    wanted = [("encoder", -1, 2, 50), ("index", 1, 360_000, 20)]
    assert told[-2:] == wanted
    lost = iter([DeviceLost("unplugged")])

    def status(self: Controller) -> Any:
        if error := next(lost, None):
            raise error

    monkeypatch.setattr(Controller, "status", status)
    monkeypatch.setattr(machines.controller._wire, "reopen", told.clear)
    machines.controller.revive()
    assert told[0] == ("hello",) and told[-2:] == wanted, "a hello forgets what measures"
    close(machines)
    assert "position" not in {one.about for one in guarantees(config.setup, 40.0).lacking}


def test_what_measures_must_reach_who_counts() -> None:
    for tables, why in (
        ((ZABER.format("/dev/y"), ALP, feedback("encoder", counts=500)), "at the controller's input"),
        ((STEPPER, VIDEO, feedback("index")), "expected pin"),
        ((MOTOR, ALP, feedback("index", pin=4)), "pin is only for"),
        ((MOTOR, ALP, feedback("encoder", counts=3)), "two counts"),
        ((MOTOR, ALP, feedback("index"), feedback("index")), "at most one encoder and one index"),
        ((MOTOR, '[display]\ndriver = "lightcrafter"\ncontrol = "1"\n'), 'expected "usb"'),
        ((MOTOR, '[display]\ndriver = "lightcrafter"\nrefresh = "100 Hz"\n'), "cannot be shown"),
        ((MOTOR, ALP, feedback("camera")), "expected producer"),
        ((MOTOR, ALP, feedback("camera", config='"a.cfg"', label='"C"', gain=2.0)), "gain; set it there"),
    ):
        with pytest.raises(JobError, match=why):
            rig(*tables)
    web = (HEAD + '[controller]\nport = "/dev/x"\n' + MOTOR + ALP + feedback("index")).replace('"vial"', '"web"')
    with pytest.raises(JobError, match="expected distance"):
        parse_rig(web)


def test_an_index_at_a_pin(monkeypatch: pytest.MonkeyPatch) -> None:
    mock = pytest.importorskip("gpiozero.pins.mock", reason='pip install "vamgpu[gpio]"')
    import gpiozero

    factory = mock.MockFactory()
    monkeypatch.setattr(gpiozero.Device, "pin_factory", factory)
    clock = VirtualClock()
    index, pin = GpioIndex.open(17, clock), factory.pin(17)
    for moment in (5, 9):
        clock.sleep_until(moment)
        pin.drive_high()
        pin.drive_low()
    assert index.edges() == (5, 9) and index.edges() == ()
    with pytest.raises(DeviceNotFound, match="no pin 17"):
        GpioIndex.open(17, clock)
    pulses: Any = SimpleNamespace(rate=lambda hz: hz, close=lambda: None)
    StepperStage(pulses, clock, 10.0, index=index).close()
    GpioIndex.open(17, clock).close()
    with pytest.raises(DeviceNotFound, match="no pin 999"):
        GpioIndex.open(999)
    monkeypatch.setattr(
        stepper, "SysfsPwm", lambda chip, channel: SimpleNamespace(rate=lambda hz: hz, close=lambda: None)
    )
    monkeypatch.setattr(projector, "PygletWindow", lambda *_: SimpleNamespace(close=lambda: None))
    machines = opened(parse_rig(HEAD + STEPPER + VIDEO + feedback("index", pin=22)))
    assert isinstance(machines, VideoMachines) and isinstance(machines.stage._index, GpioIndex)  # type: ignore[attr-defined]
    close(machines)
    GpioIndex.open(22, clock).close()


def test_a_lightcrafter_is_display_and_light(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    device, asked = EmulatedLightCrafter(), []
    monkeypatch.setattr(LightCrafter, "open", lambda serial, **_: asked.append(serial) or LightCrafter(device))
    window = SimpleNamespace(size=(8, 12), rate_hz=60.0, close=lambda: None)
    monkeypatch.setattr(projector, "PygletWindow", lambda *_: window)
    with PtyServer(EmulatedStage(rotary=True)) as stage:
        config = parse_rig(HEAD + ZABER.format(stage.url) + CRAFTER + 'control = "usb:42"\n')
        machines = opened(config)
        assert isinstance(machines, VideoMachines) and isinstance(machines.lamp, LightCrafter) and asked == ["42"]
        assert device.settings[dlpc350.TIMES] == (8333).to_bytes(4, "little") * 2
        assert device.settings[dlpc350.LED_CURRENTS] == bytes([255, 255, 127]) and not device.lit
        machines.lamp.on()
        assert device.lit, "the patterns run, and its LEDs light them"
        close(machines)
        assert device.closed and not device.lit
        device.closed = False
        outside = opened(parse_rig(f'{config.text}[controller]\nport = "{line}"\n'))
        assert isinstance(outside, VideoMachines) and outside.lamp is None, "the controller gates another lamp"
        close(outside)
        assert device.closed
        device.closed = False
        monkeypatch.setattr(projector, "PygletWindow", absent)
        with pytest.raises(DeviceNotFound, match="no screen"):
            opened(config)
        assert device.closed, "what fails leaves nothing open"


def absent(*_: object) -> None:
    raise DeviceNotFound("there is no screen")


def test_cameras_are_opened_with_their_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(camera.GenicamCamera, "open", lambda *names, **settings: seen.append((names, settings)))
    keys = {"producer": '"a.cti"', "exposure": '"5 ms"', "gain": 3.0, "format": '"Mono12"', "trigger": '"Line0"'}
    found = rig(MOTOR, ALP, feedback("camera", **keys)).setup.camera
    assert found is not None
    found.open()
    settings = {"exposure_us": 5000.0, "gain": 3.0, "pixels": "Mono12", "trigger": "Line0"}
    assert seen.pop() == (("a.cti", None), {**settings, "binning": 1, "crop": None})
    monkeypatch.setattr(micromanager.MicroManagerCamera, "open", lambda *names: SimpleNamespace(
        frame=lambda *area: seen.append((names, area)), close=lambda: seen.append("closed"),
        expose=lambda microseconds: seen.append((names, microseconds))))  # fmt: skip
    found = rig(MOTOR, ALP, feedback("camera", config='"a.cfg"', label='"Cam"')).setup.camera
    assert found is not None
    found.open()
    assert seen == [(("a.cfg", "Cam"), (1, None)), (("a.cfg", "Cam"), 10_000.0)]
