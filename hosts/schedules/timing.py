"""Exact times, whole nanoseconds of fractions: a million frames later nothing has drifted."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, isfinite, nextafter

import numpy as np

from vamgpu.errors import BadInput

SECOND = 10**9
"""Nanoseconds of a second."""

Number = int | float | Fraction
"""What times and speeds are given as; a float counts as the decimal it is written as: 0.1 is a tenth."""


def exact(name: str, value: Number, *, zero: bool = False) -> Fraction:
    """A number > 0 (≥ 0 with ``zero``) as a fraction. Raises `BadInput`."""
    if isinstance(value, bool) or not isinstance(value, (int, float, Fraction)) or not isfinite(value):
        raise BadInput(f"{name} is {value!r}; wanted a finite number")
    number = Fraction(repr(float(value))) if isinstance(value, float) else Fraction(value)
    if number < 0 or (number == 0 and not zero):
        raise BadInput(f"{name} is {value!r}; wanted {'≥ 0' if zero else '> 0'}")
    return number


def nanoseconds(name: str, seconds: Number) -> int:
    """Seconds ≥ 0 as whole nanoseconds, rounded up: a machine is given its time. Raises `BadInput`."""
    return ceil(exact(name, seconds, zero=True) * SECOND)


def below(bound: Fraction) -> float:
    """The greatest float whose decimal is no more than a fraction."""
    value = float(bound)
    while Fraction(repr(value)) > bound:
        value = nextafter(value, 0.0)
    return value


@dataclass(frozen=True)
class Cadence:
    """Beats at ``start`` + ⌊k · ``period``⌋ [ns]. Each is computed from its number, never from the one before it."""

    period: Fraction
    start: int = 0

    def __post_init__(self) -> None:
        if self.period < 1:
            raise BadInput(f"the period is {float(self.period):g} ns; wanted at least 1")

    def at(self, beat: int) -> int:
        """When a beat falls [ns]."""
        return self.start + beat * self.period.numerator // self.period.denominator

    def times(self, first: int, count: int, stride: int = 1) -> np.ndarray:
        """When beats first, first + stride, … fall [ns], int64 (count,)."""
        top, bottom = self.period.numerator, self.period.denominator
        whole, rest = divmod(top, bottom)
        beats = first + stride * np.arange(count, dtype=np.int64)
        if max(bottom, rest * max(abs(first), abs(first + stride * count))) < 2**62:
            return self.start + beats * whole + beats * rest // bottom
        return np.array([self.start + beat * top // bottom for beat in beats.tolist()], np.int64)  # beyond 64 bits

    def beat(self, time: int) -> int:
        """The last beat at or before a time [ns]."""
        return ((time - self.start + 1) * self.period.denominator - 1) // self.period.numerator
