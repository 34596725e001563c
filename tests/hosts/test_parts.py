"""Machines of rigs without a controller: steppers by pulses, their index, and lamps behind a control line."""

from __future__ import annotations

from pathlib import Path

import pytest

from vamgpu.errors import BadInput, DeviceError, DeviceLost, DeviceNotFound
from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.drivers.stepper import StepperStage, SysfsPwm
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.rigs import EmulatedLine
from vamgpu.hosts.emulators.stage import EmulatedStepper

SECOND = 1_000_000_000


def stepper(off: float = 0.0, indexed: bool = False) -> tuple[VirtualClock, EmulatedStepper, StepperStage]:
    clock = VirtualClock()
    motor = EmulatedStepper(clock, 36_000.0, off)
    return clock, motor, StepperStage(motor, clock, 100.0, ramp=40.0, index=motor if indexed else None)


def test_a_stepper_counts_its_pulses() -> None:
    clock, motor, stage = stepper(off=100.0)
    assert isinstance(stage, Stage)
    stage.run(40.0)
    assert clock.now() == pytest.approx(SECOND, rel=0.02), "a second of ramp"
    clock.sleep(100 * SECOND)
    assert motor.position(clock.now()) / 100.0 - stage.position() == pytest.approx(4020 * 100e-6, rel=0.01)
    stage.stop()
    rest = stage.position()
    clock.sleep(SECOND)
    assert stage.position() == rest
    stage.move(rest + 10.0, 5.0)
    assert stage.position() == pytest.approx(rest + 10.0)
    for wrong in (lambda: stage.move(0.0, 5.0), lambda: stage.run(-1.0), lambda: StepperStage(motor, clock, 0.0)):
        with pytest.raises(BadInput):
            wrong()


def test_an_index_corrects_it_once_a_turn() -> None:
    clock, motor, stage = stepper(off=1000.0, indexed=True)
    stage.run(40.0)
    while clock.now() < 60 * SECOND:
        clock.sleep(SECOND // 10)
        stage.position()
    assert abs(motor.position(clock.now()) / 100.0 - stage.position()) < 2 * 0.36, (
        "0.1 % of a turn, since the first mark"
    )
    motor.stall()
    with pytest.raises(DeviceError, match="no index for 1.2 turns; check motor"):
        for _ in range(200):
            clock.sleep(SECOND // 10)
            stage.position()


def test_a_pwm_is_told_what_it_can_give(tmp_path: Path) -> None:
    with pytest.raises(DeviceNotFound, match="overlay"):
        SysfsPwm(0, 2, tmp_path)
    place = tmp_path / "pwmchip0" / "pwm2"
    place.mkdir(parents=True)
    pwm = SysfsPwm(0, 2, tmp_path)
    assert (place / "enable").read_text() == "0\n"
    assert pwm.rate(3000.0) == pytest.approx(1e9 / 333_333)
    assert [(place / name).read_text() for name in ("period", "duty_cycle", "enable")] == [
        "333333\n",
        "166666\n",
        "1\n",
    ]
    pwm.close()
    assert (place / "enable").read_text() == "0\n"
    (place / "enable").unlink()
    (place / "enable").mkdir()
    with pytest.raises(DeviceError, match="check its permissions"):
        pwm.rate(0.0)


def test_a_lamp_behind_a_control_line() -> None:
    heard: list[bool] = []
    line = EmulatedLine(heard.append)
    lamp = TtlLamp(line)
    lamp.on(0.5)
    lamp.on(0.5)
    lamp.off()
    lamp.off()
    assert heard == [True, False]
    lamp.on(1.0)
    line.unplugged = True
    with pytest.raises(DeviceLost, match="is lost"):
        lamp.off()
    with pytest.raises(DeviceNotFound, match="/dev/none"):
        TtlLamp.open("/dev/none")
