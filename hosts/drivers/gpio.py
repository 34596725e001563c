"""A computer's own inputs, such as a Raspberry Pi's: the edges of an index mark, through the package ``gpiozero``."""

from __future__ import annotations

from collections import deque
from typing import Any, Self

from vamgpu.errors import DeviceNotFound
from vamgpu.hosts.drivers.cleanup import Closing, extra
from vamgpu.hosts.schedules.clock import Clock, RealClock

MOST = 1000  # edges that wait to be asked for; a mark comes once a turn


class GpioIndex(Closing):
    """An index mark at a pin. device: gpiozero's ``DigitalInputDevice``, which calls in a thread of its own."""

    def __init__(self, device: Any, clock: Clock) -> None:
        self._device, self._clock = device, clock
        self._edges: deque[int] = deque(maxlen=MOST)
        device.when_activated = self._seen

    @classmethod
    def open(cls, pin: int, clock: Clock | None = None) -> Self:
        """Open a pin by its number (BCM on a Raspberry Pi); a mark is its rising edge."""
        with extra("gpio", "an index at a pin needs gpiozero"):
            from gpiozero import DigitalInputDevice  # type: ignore[import-not-found]
        try:
            device = DigitalInputDevice(pin)
        except Exception as error:  # each of its ways to the pins has errors of its own
            raise DeviceNotFound(
                f"there is no pin {pin} ({error}); run on the computer that has it, and close what else uses it"
            ) from error
        return cls(device, clock or RealClock())

    def _seen(self) -> None:
        self._edges.append(self._clock.now())

    def edges(self) -> tuple[int, ...]:
        """Times of the marks since it was asked last [ns]."""
        return tuple(self._edges.popleft() for _ in range(len(self._edges)))

    def close(self) -> None:
        """Let go of the pin; more than once does no harm."""
        self._device.close()
