"""An emulated instrument that speaks SCPI: a photodiode's meter."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from vamgpu.hosts.emulators.line import LineDevice


class EmulatedMeter(LineDevice):
    """A photodiode's meter that reads ``light(now)`` [mW], with noise [mW]; above its range it has no value."""

    wavelength: float
    count: int

    def __init__(
        self, light: Callable[[int], float], noise_mw: float = 0.0, greatest_mw: float = 500.0, seed: int = 0
    ) -> None:
        super().__init__(5000.0)
        self.errors: deque[str] = deque()
        self._light, self._noise, self._greatest = light, noise_mw, greatest_mw
        self._random = np.random.default_rng(seed)
        self.wavelength, self.count = 405.0, 1

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        for line in self.lines(data):
            if words := line.decode("ascii", "replace").upper().split():
                answer = self._answer(words, now)
                if answer is None:
                    self.errors.append('-113,"Undefined header"')
                elif answer:
                    self._out.put(answer.encode("ascii") + b"\n", now)

    def _answer(self, words: list[str], now: int) -> str | None:
        """The answer to a command ('' if it has none), or None if there is no such command."""
        match words:
            case ["*IDN?"]:
                return "Emulated,PM400,1001,1.0"
            case ["*CLS"]:
                self.errors.clear()
                return ""
            case ["SYST:ERR?"]:
                return self.errors.popleft() if self.errors else '+0,"No error"'
            case ["MEAS:POW?"]:
                reading = self._light(now) + self._noise / self.count**0.5 * self._random.standard_normal()
                return "9.91E+37" if reading > self._greatest else f"{reading / 1000:.9E}"
            case ["SENS:CORR:WAV", value]:
                wavelength = float(value)
                if 350 <= wavelength <= 1100:
                    self.wavelength = wavelength
                else:
                    self.errors.append('-222,"Data out of range"')
                return ""
            case ["SENS:AVER:COUN", value]:
                self.count = int(value)
                return ""
        return None
