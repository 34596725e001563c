"""A tunable lens that takes time: a damped oscillator that is asked for one power after another."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from math import cos, exp, pi, sin, sqrt

SECOND = 1_000_000_000


@dataclass(frozen=True)
class LensModel:
    """What the lens does: a damped oscillator, a power a milliampere, and a drift with temperature."""

    natural_hz: float = 300.0
    damping: float = 0.9
    diopters_per_ma: float = 0.05
    offset: float = 0.0
    drift_per_celsius: float = 0.067
    reference_celsius: float = 25.0
    least: float = -1.5
    greatest: float = 3.5


class Glass:
    """Focal power over time after steps of what is asked of it, in closed form."""

    def __init__(self, model: LensModel) -> None:
        self.model = model
        self._steps: deque[tuple[int, float, float, float]] = deque([(0, 0.0, 0.0, 0.0)], maxlen=4096)

    def step(self, now: int, wanted: float) -> None:
        """Ask for another power [1/m]."""
        power, rate = self.state(now)
        while len(self._steps) > 1 and self._steps[-1][0] >= now:
            self._steps.pop()
        self._steps.append((now, power, rate, wanted))

    def state(self, now: int) -> tuple[float, float]:
        """Power [1/m] and its rate [1/m/s] at a time, past or future."""
        index = bisect_right(self._steps, now, key=lambda step: step[0])
        start, power, rate, wanted = self._steps[max(index - 1, 0)]
        t = max(now - start, 0) / SECOND
        omega = 2 * pi * self.model.natural_hz
        decay = omega * self.model.damping
        ringing = omega * sqrt(max(1 - self.model.damping**2, 1e-12))
        offset = power - wanted
        b = (rate + decay * offset) / ringing
        fade, c, s = exp(-decay * t), cos(ringing * t), sin(ringing * t)
        moved = fade * (offset * c + b * s)
        speed = fade * ((b * ringing - decay * offset) * c - (offset * ringing + decay * b) * s)
        return wanted + moved, speed
