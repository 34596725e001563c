"""Instruments that speak SCPI: meters and supplies, and what they do when they fail."""

from __future__ import annotations

import pytest

from vamgpu.errors import BadInput, DeviceLost, DeviceRefused, ProtocolError, WrongDevice
from vamgpu.hosts.drivers.scpi import LampSupply, PowerMeter
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.instruments import EmulatedMeter, EmulatedSupply
from vamgpu.hosts.emulators.line import Faults, LineMachine
from vamgpu.hosts.emulators.ports import plug


def _wire(machine: LineMachine, clock: VirtualClock, faults: Faults | None = None, timeout_s: float = 0.1) -> Wire:
    return Wire(plug(machine, clock, timeout_s, faults=faults), "the machine")


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
