"""A stepper with pulses from a computer's hardware PWM, which are counted, and an index at an input pin."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any, Protocol, Self

from vamgpu.errors import BadInput, DeviceError, DeviceNotFound
from vamgpu.hosts.drivers.cleanup import Closing, all_of, extra
from vamgpu.hosts.schedules.clock import Clock, RealClock
from vamgpu.hosts.schedules.timing import SECOND

STEP = SECOND // 100  # time between two rates of a ramp [ns]
CREDIBLE = 0.01  # share of a turn by which clocks may differ; more means lost steps
OVERDUE = 1.2  # turns without an index after which the motion counts as lost


class PulseOutput(Protocol):
    """An output of evenly spaced pulses."""

    # set the pulses per second, 0 for none; returns the actual rate by its own clock
    def rate(self, hz: float) -> float: ...
    def close(self) -> None: ...  # stop the pulses, and release it


class IndexInput(Protocol):
    """An input that records when a mark passed."""

    def edges(self) -> tuple[int, ...]: ...  # times of the edges since the last call [ns of the rig's clock]
    def close(self) -> None: ...  # release the input


class SysfsPwm(Closing):
    """A channel of a PWM chip, through Linux's ``/sys/class/pwm``."""

    def __init__(self, chip: int, channel: int, root: Path = Path("/sys/class/pwm")) -> None:
        place = root / f"pwmchip{chip}"
        if not place.is_dir():
            raise DeviceNotFound(f"there is no {str(place)!r}; enable the PWM's overlay, or correct chip in [motion]")
        self._place = place / f"pwm{channel}"
        if not self._place.is_dir():
            self._write(place / "export", channel)
        self.rate(0.0)

    @staticmethod
    def _write(file: Path, value: int) -> None:
        try:
            file.write_text(f"{value}\n", encoding="ascii")
        except OSError as error:
            raise DeviceError(f"cannot write {str(file)!r}: {error.strerror}; check its permissions") from error

    def rate(self, hz: float) -> float:
        if hz == 0:
            self._write(self._place / "enable", 0)
            return 0.0
        period = round(SECOND / hz)
        self._write(self._place / "duty_cycle", 0)  # a period shorter than the pulse is rejected
        self._write(self._place / "period", period)
        self._write(self._place / "duty_cycle", period // 2)
        self._write(self._place / "enable", 1)
        return SECOND / period

    def close(self) -> None:
        self.rate(0.0)


class StepperStage(Closing):
    """A `Stage` that only moves forwards by pulses; an index at 0 of each turn corrects position and rate."""

    def __init__(
        self, pulses: PulseOutput, clock: Clock, microsteps: float, unit: str = "deg", ramp: float = 100.0,
        index: IndexInput | None = None,
    ) -> None:  # fmt: skip
        if not microsteps > 0 or not ramp > 0 or unit not in ("mm", "deg"):
            raise BadInput(f"{microsteps} pulses per {unit!r}, ramp {ramp} are not possible; expected numbers above 0")
        self.microsteps = microsteps
        self.unit = unit
        self._pulses, self._clock, self._ramp, self._index = pulses, clock, ramp, index
        self._at, self._since, self._speed = 0.0, clock.now(), 0.0
        self.marks = None if index is None else 0
        self._found, self._seen, self._gain = False, self._at, 1.0

    def _position(self, now: int) -> float:
        return self._at + self._speed * (now - self._since) / SECOND

    def position(self) -> float:
        """The pulses so far, corrected by the index."""
        for edge in () if self._index is None else self._index.edges():
            self._marked(edge)
        here = self._position(self._clock.now())
        if self._index is not None and here - self._seen > OVERDUE * 360.0:
            raise DeviceError(f"no index for {(here - self._seen) / 360:.2g} turns; check motor, coupling and sensor")
        return here

    def _marked(self, edge: int) -> None:
        """Correct the position and the pulses per turn by the mark."""
        if edge < self._since:  # at another speed, the mark shows motion but gives no angle
            self._seen = self._position(self._clock.now())
            return
        here = self._position(edge)
        turned = 360.0 * round((here - self._seen) / 360.0) if self._found else 0.0
        self._seen, self._found = 360.0 * round(here / 360.0), True
        self.marks = (self.marks or 0) + 1
        missed = here - self._seen
        self._at -= missed
        if turned and abs(missed) < CREDIBLE * turned:
            self._gain *= turned / (turned + missed)
            self._set(self._speed)

    def move(self, position: float, speed: float) -> None:
        """Move forwards to a position; returns when it is reached."""
        if not speed > 0 or (way := position - self.position()) < 0:
            raise BadInput(f"a move to {position:g} at {speed:g}; expected one forwards, at a speed above 0")
        self._clock.sleep_until(self._clock.now() + round(way / self._set(speed) * SECOND) if way else 0)
        self._set(0.0)

    def run(self, speed: float) -> None:
        """Change to a speed with the ramp, and keep it; 0 stops the axis."""
        if speed < 0:
            raise BadInput(f"a speed of {speed:g} {self.unit}/s; this stepper only turns forwards")
        while abs(speed - self._speed) > (change := self._ramp * STEP / SECOND):
            self._set(self._speed + (change if speed > self._speed else -change))
            self._clock.sleep_until(self._clock.now() + STEP)
        self._set(speed)

    def _set(self, speed: float) -> float:
        now = self._clock.now()
        self._at, self._since = self._position(now), now
        self._speed = self._pulses.rate(speed * self.microsteps / self._gain) / self.microsteps * self._gain
        return self._speed

    def wait(self) -> None:
        """It is at rest when `run` and `move` return."""

    def stop(self) -> None:
        self.run(0.0)

    def close(self) -> None:
        index = () if self._index is None else (self._index.close,)
        all_of(lambda: self._set(0.0), self._pulses.close, *index)


MOST = 1000  # edges that wait to be read; a mark comes once per turn


class GpioIndex(Closing):
    """An index mark at a pin. device: gpiozero's ``DigitalInputDevice``, which calls in a separate thread."""

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
        except Exception as error:  # its pin libraries raise different errors
            raise DeviceNotFound(
                f"there is no pin {pin} ({error}); run on the computer that has it, and close other programs"
            ) from error
        return cls(device, clock or RealClock())

    def _seen(self) -> None:
        self._edges.append(self._clock.now())

    def edges(self) -> tuple[int, ...]:
        return tuple(self._edges.popleft() for _ in range(len(self._edges)))

    def close(self) -> None:
        self._device.close()
