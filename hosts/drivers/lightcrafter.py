"""LightCrafters on USB: the pattern mode for video frames, and its LEDs as light."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Self

from vamgpu.errors import BadInput, DeviceError, DeviceLost, DeviceNotFound, DeviceRefused
from vamgpu.hosts.drivers import dlpc350_protocol as dlpc350
from vamgpu.hosts.drivers.cleanup import ClosedOnce, close_all, closed_on_error, extra
from vamgpu.hosts.drivers.projector import HdmiProjector, SlotLayout, Window

LATE = 16  # most answers to earlier commands, which came after their time-out
PATIENCE = 15.0  # longest wait for a state of the projector [s]


class LightCrafter(ClosedOnce):
    """The projector's controller on hidapi's device: patterns from the video cable, LEDs off until `on`."""

    called = "the projector"

    def __init__(
        self, device: Any, timeout_s: float = 1.0, pause: Callable[[float], None] = time.sleep,
        dlpc: dlpc350.Dlpc = dlpc350.DLPC350,
    ) -> None:  # fmt: skip
        self._dlpc = dlpc
        self._device, self._timeout, self._pause = device, round(timeout_s * 1000), pause
        self._number, self._lit, self._lock = 0, False, threading.RLock()
        with closed_on_error(device):
            self.off()

    @classmethod
    def open(cls, serial: str | None = None, timeout_s: float = 1.0, dlpc: dlpc350.Dlpc = dlpc350.DLPC350) -> Self:
        """Open the projector with a serial number, or the first; its LEDs are off."""
        with extra("lightcrafter", "LightCrafters need hidapi"):
            import hid  # type: ignore[import-not-found]
        device = hid.device()
        try:
            device.open(dlpc350.VENDOR, dlpc.product, serial)
        except (OSError, ValueError) as error:
            raise DeviceNotFound(
                f"{dlpc.name} {serial or ''} does not open ({error}); check plug, power and permissions, and close "
                "other programs that use it"
            ) from error
        return cls(device, timeout_s, dlpc=dlpc)

    def _ask(self, command: int, data: bytes, what: str, read: bool = False) -> bytes:
        with self._lock:  # a stop comes from any thread
            return self._answered(command, data, what, read)

    def _answered(self, command: int, data: bytes, what: str, read: bool) -> bytes:
        self._number = (self._number + 1) % 256
        raw = dlpc350.frame(command, data, self._number, read)
        try:
            for start in range(0, len(raw), dlpc350.REPORT):
                if self._device.write(b"\0" + raw[start : start + dlpc350.REPORT]) < 0:
                    raise OSError("the report was not accepted")
            for _ in range(LATE):
                answer = bytes(self._device.read(dlpc350.REPORT, self._timeout))
                if not answer or answer[1] == self._number:
                    break
        except (OSError, ValueError) as error:
            raise DeviceLost(f"the projector is lost ({error}); check its plug and its power") from error
        if not answer:
            raise DeviceLost(f"the projector does not answer {what}; check its plug and its power")
        return dlpc350.parse_reply(answer, self._number, what)

    def show_video(
        self, channels: tuple[int, ...], bits: int, exposure_us: int, period_us: int, leds: str | tuple[str, ...],
        refresh_hz: float = 60.0,
    ) -> None:  # fmt: skip
        """Show patterns of each video frame in turn, checked by the projector before they start."""
        chosen = (leds,) if isinstance(leds, str) else leds
        if not chosen or not set(chosen) <= set(dlpc350.COLORS):
            raise BadInput(f"LEDs {chosen}; expected some of {', '.join(dlpc350.COLORS)}")
        dlpc350.times(bits, len(channels), exposure_us, period_us, int(1e6 / refresh_hz), self._dlpc.shortest_us)
        lit = sum(1 << dlpc350.COLORS.index(name) for name in set(chosen))
        for step in self._dlpc.video(channels, bits, exposure_us, period_us, lit):
            if step.data is not None:
                self._ask(step.command, step.data, step.what)
            elif found := step.faults(self._awaited(step)):
                raise DeviceRefused(f"the projector finds its patterns invalid: {', '.join(found)}", "validate")

    def _awaited(self, step: dlpc350.Step) -> int:
        """The answer to a query, once it has the bits that are expected."""
        waited = 0.0
        while True:
            data = self._ask(step.command, b"", step.what, read=True)
            if not data:
                raise DeviceRefused(f"the projector has no answer to {step.what}", "empty")
            if data[0] & step.mask == step.value:
                return data[0]
            if waited > PATIENCE:
                raise DeviceLost(
                    f"the projector has not reached {step.what} in {PATIENCE} s; check its video cable, or "
                    "turn it off and on"
                )
            self._pause(0.05)
            waited += 0.05

    def drive(self, red: float = 0.0, green: float = 0.0, blue: float = 0.0) -> None:
        """Set the LEDs' currents as shares of the greatest."""
        if not all(0 <= each <= 1 for each in (red, green, blue)):
            raise BadInput(f"LEDs cannot be driven at {red}, {green}, {blue} of their greatest current; give 0..1")
        codes = bytes(round(each * 255) ^ (255 if self._dlpc.inverted else 0) for each in (red, green, blue))
        self._ask(dlpc350.LED_CURRENTS, codes, "the LEDs' currents")

    def on(self, power: float = 1.0) -> None:
        """Turn the light on: the LEDs follow the patterns; may be called again."""
        self._ask(dlpc350.LED_ENABLE, bytes([0b1000]), "light on")
        self._lit = True

    def off(self) -> None:
        """Turn the light off: no LED is enabled; may be called again."""
        self._ask(dlpc350.LED_ENABLE, b"\0", "light off")
        self._lit = False

    def inspect(self) -> None:
        """Raise `DeviceError` if the patterns have stopped, or if the LEDs are off that should be on."""
        state = self._ask(dlpc350.MAIN_STATUS, b"", "its state", read=True)
        if not state or state[0] & dlpc350.PARKED or not state[0] & dlpc350.RUNNING:
            raise DeviceError(f"the projector's patterns do not run (state {state.hex()}); check its video cable")
        leds = self._ask(dlpc350.LED_ENABLE, b"", "its LEDs", read=True)
        if self._lit and not any(leds):
            raise DeviceError("the projector's LEDs are off, and should be on; check its temperature and its power")

    def endings(self) -> tuple[Callable[[], object], ...]:
        return self.off, partial(self._ask, dlpc350.DISPLAY, b"\0", "the stop"), self._device.close


class LightCrafterScreen(HdmiProjector):
    """The screen of a LightCrafter. lamp: the LightCrafter, whose LEDs are the light; it is also released."""

    def __init__(self, window: Window, layout: SlotLayout, latency_refreshes: int, lamp: LightCrafter) -> None:
        super().__init__(window, layout, latency_refreshes)
        self.lamp = lamp

    def close(self) -> None:
        """Turn the LEDs off, show black, and close; may be called more than once."""
        close_all([super().close, self.lamp.close])
