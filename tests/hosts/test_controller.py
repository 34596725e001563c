"""The controller's driver against its emulator, with faults on the line; the web and the lamp it drives."""

from __future__ import annotations

import time

import pytest
from servers import PtyServer

from vamgpu.errors import BadInput, DeviceLost, DeviceRefused
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.controller_protocol import ControllerRow
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.line import Faults, LineDevice, VirtualPort

SECOND = 1_000_000_000


def _wire(machine: LineDevice, clock: VirtualClock, faults: Faults | None = None, timeout_s: float = 0.1) -> Wire:
    return Wire(VirtualPort(machine, clock, timeout_s, faults=faults), "the machine")


def test_the_controller_over_a_terminal() -> None:
    machine = EmulatedController()
    with PtyServer(machine) as server, Controller.open(server.url, microsteps_per_mm=200.0) as driver:
        assert (driver.capacity, driver.channels) == (256, 2)
        with pytest.raises(DeviceRefused) as refused:
            driver.arm()
        assert refused.value.code == "lease"
        driver.lease(1000)
        driver.arm()
        driver.light(1)
        assert driver.status().light == 1
        while (status := driver.status()).light:
            time.sleep(0.01)
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
                driver.row(ControllerRow(i, 1000 * i, 1000 + i, 0, 100))
            assert [row[0] for row in machine.rows] == [0, 1, 2, 3], (spoiled, byte)
            assert driver.status().free == 252


def test_a_dead_controller_is_lost() -> None:
    clock, faults = VirtualClock(), Faults()
    driver = Controller(_wire(EmulatedController(), clock, faults))
    faults.dead = True
    with pytest.raises(DeviceLost, match="3 tries"):
        driver.status()


def test_the_web_and_the_power() -> None:
    clock, machine = VirtualClock(), EmulatedController()
    driver = Controller(_wire(machine, clock), microsteps_per_mm=1000.0)
    driver.ramp(1.0)
    driver.move(0.8)
    for wrong in (lambda: driver.move(-200.1), lambda: driver.ramp(1e6), lambda: driver.ramp(0.0)):
        with pytest.raises(BadInput, match="at most|more than 0"):
            wrong()
    clock.sleep(10 * SECOND)
    assert driver.position_mm() == pytest.approx(8.0 - 0.32, abs=2e-3)
    assert driver.status().speed == 800_000
    driver.power(1, 0.75)
    assert machine.powers == [65535, round(0.75 * 65535)]
    with pytest.raises(BadInput, match="of full"):
        driver.power(1, 1.1)
    with pytest.raises(DeviceRefused, match="outside its range"):
        driver.power(2, 1.0)
