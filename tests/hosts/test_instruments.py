"""Instruments that speak SCPI: meters, and what they do when they fail."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from vamgpu.errors import BadInput, DeviceLost, DeviceNotFound, DeviceRefused, ProtocolError
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.calibration import EmulatedMeter
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import Faults, LineDevice, VirtualPort


def _wire(machine: LineDevice, clock: VirtualClock, faults: Faults | None = None, timeout_s: float = 0.1) -> Wire:
    return Wire(VirtualPort(machine, clock, timeout_s, faults=faults), "the machine")


def test_the_meter() -> None:
    clock, light = VirtualClock(), [280.0]
    meter = PowerMeter(_wire(EmulatedMeter(lambda now: light[0]), clock))
    assert meter.power_mw() == pytest.approx(280.0)
    meter.wavelength(405)
    with pytest.raises(DeviceRefused, match="out of range"):
        meter.wavelength(2000)
    light[0] = 560.0
    with pytest.raises(DeviceRefused, match="no value"):
        meter.power_mw()
    with pytest.raises(BadInput, match="nanometers"):
        meter.wavelength(0.4)


SIMULATED = """
spec: "1.1"
devices:
  meter:
    eom:
      USB INSTR: {q: "\\n", r: "\\n"}
    error: ""
    dialogues:
      - {q: "*IDN?", r: "Thorlabs,PM400,1001,1.0"}
      - {q: "*CLS"}
      - {q: "MEAS:POW?", r: "2.5E-3"}
      - {q: "SENS:CORR:WAV 405"}
      - {q: "SENS:TEMP?"}
      - {q: "SYST:ERR?", r: '+0,"No error"'}
resources:
  USB0::0x1313::0x8075::P1001::INSTR: {device: meter}
"""


def test_the_meter_through_visa(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyvisa_sim", reason='pip install "vamgpu[dev]"')
    (tmp_path / "meters.yaml").write_text(SIMULATED)
    monkeypatch.setenv("PYVISA_LIBRARY", f"{tmp_path / 'meters.yaml'}@sim")
    address = "USB0::0x1313::0x8075::P1001::INSTR"
    with PowerMeter.open(address, timeout_s=0.2) as meter:
        assert meter.power_mw() == pytest.approx(2.5)
        meter.wavelength(405)
        with pytest.raises(DeviceLost, match="SENS:TEMP"):
            meter.ask("SENS:TEMP?")
        assert meter.power_mw() == pytest.approx(2.5)
    with pytest.raises(DeviceLost, match="lost"):
        meter.power_mw()
    monkeypatch.setenv("PYVISA_LIBRARY", "@py")
    with pytest.raises(DeviceNotFound, match="check the address"):
        PowerMeter.open("ASRL/dev/no-such-port::INSTR")
    monkeypatch.setitem(sys.modules, "pyvisa", None)
    with pytest.raises(DeviceNotFound, match=r"vamgpu\[visa\]"):
        PowerMeter.open(address)


def test_silence_and_nonsense_from_an_instrument() -> None:
    clock, faults = VirtualClock(), Faults()
    meter = PowerMeter(_wire(EmulatedMeter(lambda now: 1.0), clock, faults))
    faults.drop_out = frozenset({faults._count["out"] + 11})
    with pytest.raises(ProtocolError, match="number"):
        meter.power_mw()
    faults.dead = True
    with pytest.raises(DeviceLost, match="MEAS:POW"):
        meter.power_mw()
