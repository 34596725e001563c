"""A lamp on a control line of a serial port."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from vamgpu.errors import BadInput, DeviceLost, DeviceNotFound
from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.player.machines import gate


def test_a_lamp_of_the_host_shines_on_a_rig_with_a_controller_too() -> None:
    log: list[str] = []

    class Switch:
        def __init__(self, name: str) -> None:
            self.name, self.dead = name, False

        def on(self, power: float) -> None:
            log.append(f"{self.name} on {power:g}")

        def off(self) -> None:
            log.append(f"{self.name} off")
            if self.dead:
                raise DeviceLost(f"{self.name} is gone")

    lamp, box = Switch("lamp"), Switch("box")
    controller = SimpleNamespace(
        power=lambda channel, share: box.on(share), arm=lambda: None, light=lambda channels: None, disarm=box.off
    )
    both, _ = gate(controller, lamp, (0,))  # type: ignore[arg-type]
    both.on(0.5)
    lamp.dead = True
    with pytest.raises(DeviceLost, match="lamp"):
        both.off()
    assert log == ["box on 0.5", "lamp on 0.5", "lamp off", "box off"]


class _Port:
    """What of pyserial's port the lamp uses; ``log`` holds the levels of RTS."""

    def __init__(self) -> None:
        self.log: list[bool | str] = []
        self.dtr, self.unplugged = True, False

    @property
    def rts(self) -> bool:
        return bool(self.log and self.log[-1])

    @rts.setter
    def rts(self, level: bool) -> None:
        if self.unplugged:
            raise OSError("device disconnected")
        self.log.append(level)

    def close(self) -> None:
        self.log.append("closed")


def test_the_lamp_is_dark_at_both_ends() -> None:
    port = _Port()
    with TtlLamp(port) as lamp:
        assert port.log == [False]
        lamp.on()
        lamp.on()
        lamp.off()
        lamp.on()
    lamp.close()
    assert port.log == [False, True, True, False, True, False, "closed"]
    TtlLamp(port := _Port(), line="dtr")
    assert port.dtr is False and port.log == []


def test_a_lamp_that_is_gone_or_wrong_is_told() -> None:
    port = _Port()
    lamp = TtlLamp(port)
    port.unplugged = True
    with pytest.raises(DeviceLost, match="may be on"):
        lamp.off()
    lamp.close()
    assert port.log[-1] == "closed"
    with pytest.raises(BadInput, match="rts, dtr"):
        TtlLamp(_Port(), line="cts")
    with pytest.raises(DeviceNotFound, match="check"):
        TtlLamp.open("/dev/no-such-port")
    lamp = TtlLamp.open("loop://")
    lamp.on()
    assert lamp._port.rts
    lamp.close()
