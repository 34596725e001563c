"""A stepper that a computer gives pulses by hardware PWM, counted and not measured, and an index at one of its pins."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any, Protocol, Self

from vamgpu.errors import BadInput, DeviceError, DeviceNotFound
from vamgpu.hosts.drivers.cleanup import Closing, extra
from vamgpu.hosts.schedules.clock import Clock, RealClock
from vamgpu.hosts.schedules.timing import SECOND

STEP = SECOND // 100  # between two rates of a ramp [ns]
CREDIBLE = 0.01  # share of a turn by which clocks may differ; more is a slip
OVERDUE = 1.2  # turns without an index after which the motion is not believed


class PulseOutput(Protocol):
    """An output of evenly spaced pulses."""

    # give so many pulses a second, 0 for none; returns how many it gives in truth, by its own clock
    def rate(self, hz: float) -> float: ...
    def close(self) -> None: ...  # no pulses, and let go of it


class IndexInput(Protocol):
    """An input that notes when a mark passed."""

    def edges(self) -> tuple[int, ...]: ...  # times of the edges since it was asked last [ns of the rig's clock]
    def close(self) -> None: ...  # let go of the input


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
            raise DeviceError(f"cannot write {str(file)!r}: {error.strerror}; check who may use the PWM") from error

    def rate(self, hz: float) -> float:
        """Give so many pulses a second; returns how many it gives."""
        if hz == 0:
            self._write(self._place / "enable", 0)
            return 0.0
        period = round(SECOND / hz)
        self._write(self._place / "duty_cycle", 0)  # a period shorter than the pulse is refused
        self._write(self._place / "period", period)
        self._write(self._place / "duty_cycle", period // 2)
        self._write(self._place / "enable", 1)
        return SECOND / period

    def close(self) -> None:
        """No more pulses."""
        self.rate(0.0)


class StepperStage(Closing):
    """A `Stage` by so many pulses a unit, forward only; an index, at 0 each turn, corrects position and rate."""

    microsteps: float

    def __init__(
        self, pulses: PulseOutput, clock: Clock, microsteps: float, unit: str = "deg", ramp: float = 100.0,
        index: IndexInput | None = None,
    ) -> None:  # fmt: skip
        if not microsteps > 0 or not ramp > 0 or unit not in ("mm", "deg"):
            raise BadInput(f"{microsteps} pulses a {unit!r}, ramp {ramp} are no stepper; expected numbers above 0")
        self.unit, self.microsteps = unit, microsteps
        self._pulses, self._clock, self._ramp, self._index = pulses, clock, ramp, index
        self._at, self._since, self._speed = 0.0, clock.now(), 0.0
        self.marks = None if index is None else 0
        self._found, self._seen, self._gain = False, self._at, 1.0

    def _position(self, now: int) -> float:
        return self._at + self._speed * (now - self._since) / SECOND

    def position(self) -> float:
        """The pulses that were given, corrected by the index."""
        for edge in () if self._index is None else self._index.edges():
            self._marked(edge)
        here = self._position(self._clock.now())
        if self._index is not None and here - self._seen > OVERDUE * 360.0:
            raise DeviceError(f"no index for {(here - self._seen) / 360:.2g} turns; check motor, coupling and sensor")
        return here

    def _marked(self, edge: int) -> None:
        """Take the mark's word for where it was, and for how far a turn's pulses went."""
        if edge < self._since:  # it had another speed then: the mark was seen, and tells no angle
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
        """Move on to a position; returns when it is there."""
        if not speed > 0 or (way := position - self.position()) < 0:
            raise BadInput(f"a move to {position:g} at {speed:g}; expected one forward, at a speed above 0")
        self._clock.sleep_until(self._clock.now() + round(way / self._set(speed) * SECOND) if way else 0)
        self._set(0.0)

    def run(self, speed: float) -> None:
        """Change to a speed, by the ramp, and keep it; 0 brings the axis to rest."""
        if speed < 0:
            raise BadInput(f"a speed of {speed:g} {self.unit}/s; a stepper by pulses turns forward only")
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
        """It rests when `run` and `move` return."""

    def stop(self) -> None:
        """Come to rest."""
        self.run(0.0)

    def close(self) -> None:
        """Stop, and let go of output and index."""
        try:
            self._set(0.0)
            self._pulses.close()
        finally:
            if self._index is not None:
                self._index.close()


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
