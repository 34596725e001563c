"""The lens's driver against its emulator, over terminals, sockets and virtual ports, with faults on the line."""

from __future__ import annotations

import pytest
from servers import PtyServer
from tcp_server import TcpServer

from vamgpu.errors import DeviceError, DeviceLost, DeviceRefused, ProtocolError, WrongDevice
from vamgpu.hosts.drivers import optotune_protocol as ld4
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.line import Faults, LineDevice, VirtualPort

MILLI = 1_000_000


def _wire(machine: LineDevice, clock: VirtualClock, faults: Faults | None = None, timeout_s: float = 0.1) -> Wire:
    return Wire(VirtualPort(machine, clock, timeout_s, faults=faults), "the machine")


@pytest.mark.parametrize("server_of", [PtyServer, TcpServer])
def test_the_lens_over_a_terminal_and_a_socket(server_of: type[PtyServer] | type[TcpServer]) -> None:
    lens = EmulatedLens(stray=True, celsius=30.0)
    with server_of(lens) as server, LensDriver.open(server.url, firmware="A", timeout_s=0.1) as driver:
        assert driver.version == "1.9.1000.7" and driver.full_current_ma == 292.84
        found = driver.focal_power_mode(20, 45)
        assert (found.status, found.least, found.greatest) == (0, -1.5, 3.5)
        for diopters in (0.0, 1.0, 2.0):
            driver.set_power(diopters)
        assert driver.power() == 2.0 and driver.temperature() == 30.0 and driver.status() == ()
        assert lens.handshakes == 1 and lens.settings == 3


def test_the_lens_is_held_to_its_firmware_and_mode() -> None:
    clock = VirtualClock()
    with pytest.raises(WrongDevice, match="firmware type C"):
        LensDriver(_wire(EmulatedLens(firmware="C"), clock), "A")
    driver = LensDriver(_wire(EmulatedLens(), clock))
    with pytest.raises(DeviceError, match="focal_power_mode"):
        driver.set_power(1.0)
    blind = LensDriver(_wire(EmulatedLens(sensor=False), clock))
    with pytest.raises(DeviceRefused, match="lens or sensor missing"):
        blind.focal_power_mode()
    with pytest.raises(DeviceRefused, match="not compatible"):
        blind.ask(ld4.FOCAL_POWER_MODE)
    with pytest.raises(DeviceRefused, match="sensor"):
        blind.temperature()


def test_faults_on_the_lens_line() -> None:
    clock, faults = VirtualClock(), Faults()
    lens = EmulatedLens()
    port = VirtualPort(lens, clock, 0.1, faults=faults)
    driver = LensDriver(Wire(port, "the lens driver"))
    driver.focal_power_mode()
    faults.drop_out = frozenset({faults._count["out"] + 3})
    with pytest.raises(ProtocolError, match="8 of the 9 bytes"):
        driver.temperature()
    assert driver.temperature() == 25.0, "the line recovers"
    faults.dead = True
    with pytest.raises(ProtocolError, match="did not answer"):
        driver.temperature()
    port.unplug()
    with pytest.raises(DeviceLost, match="lost"):
        driver.set_power(1.0)


def test_the_lens_settles_on_the_virtual_clock() -> None:
    clock, lens = VirtualClock(), EmulatedLens()
    driver = LensDriver(Wire(VirtualPort(lens, clock, baud=38400), "the lens driver"))
    driver.focal_power_mode()
    clock.sleep(100 * MILLI)
    start = clock.now()
    driver.set_power(1.0)
    assert clock.now() == start, "a setting is not waited for"
    clock.sleep(2_604_000)
    assert abs(lens.power(clock.now())) < 1e-6
    clock.sleep(5_000_170)
    assert abs(lens.power(clock.now()) - 1) < 1e-3
