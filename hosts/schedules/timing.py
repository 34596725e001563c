"""Exact times, whole nanoseconds from fractions, without drift over a million frames."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, nextafter
from numbers import Rational, Real
from typing import Any, TypeGuard

import numpy as np

from vamgpu.errors import BadInput

SECOND = 10**9  # nanoseconds per second
DAY = 86400 * SECOND  # the longest time for a machine [ns]
FARTHEST = 2**62  # the last time in tables [ns]
GREATEST = 10**30  # numbers beyond it, and below its inverse, are typing errors

Number = int | float | Fraction  # type of times and speeds; a float counts as its decimal: 0.1 is a tenth


def numeric(value: object) -> TypeGuard[Number]:
    """Whether it is a number of Python, a fraction, or a number of NumPy."""
    return isinstance(value, Real) and not isinstance(value, bool)


def fraction(name: str, value: Number) -> Fraction:
    """A number as a fraction. Raises `BadInput`."""
    number: Any = value
    if isinstance(value, Real) and not isinstance(value, Rational):
        number = float(value)
    if not numeric(value) or number != number or abs(number) > GREATEST:
        raise BadInput(f"{name} is {_told(value)}; expected a finite number")
    if isinstance(number, Rational):
        return Fraction(int(number.numerator), int(number.denominator))
    return Fraction(repr(number))


def exact(name: str, value: Number, *, zero: bool = False) -> Fraction:
    """A number > 0 (≥ 0 with ``zero``) as a fraction. Raises `BadInput`."""
    number = fraction(name, value)
    if number < 0 or (number == 0 and not zero) or 0 < number * GREATEST < 1:
        raise BadInput(f"{name} is {_told(value)}; expected {'≥ 0' if zero else '> 0'}")
    return number


def whole(name: str, value: Number, least: int = 1) -> int:
    """A whole number of at least ``least``. Raises `BadInput`."""
    number = fraction(name, value)
    if number.denominator != 1 or number < least:
        raise BadInput(f"{name} is {_told(value)}; expected a whole number ≥ {least}")
    return int(number)


def nanoseconds(name: str, seconds: Number) -> int:
    """Seconds ≥ 0 as whole nanoseconds, rounded up to give a machine its full time. Raises `BadInput`."""
    time = ceil(exact(name, seconds, zero=True) * SECOND)
    if time > DAY:
        raise BadInput(f"{name} is {_told(seconds)}; expected at most a day")
    return time


def every(name: str, values: Any) -> tuple[Any, ...]:
    """The members of a sequence. Raises `BadInput` for other values."""
    if not isinstance(values, (str, bytes)):
        try:
            return tuple(values)
        except TypeError:
            pass
    raise BadInput(f"{name} is {_told(values)}; expected a sequence")


def _told(value: object) -> str:
    """A value for messages, shortened if long."""
    text = repr(value) if not isinstance(value, int) or abs(value) < GREATEST else "an integer beyond 1e30"
    return text if len(text) <= 60 else text[:57] + "..."


def below(bound: Fraction) -> float:
    """The greatest float whose decimal does not exceed a fraction."""
    value = float(bound)
    while Fraction(repr(value)) > bound:
        value = nextafter(value, 0.0)
    return value


@dataclass(frozen=True)
class Cadence:
    """Beats at ``start`` + ⌊k · ``period``⌋ [ns]. Each is computed from its number, never from the one before."""

    period: Fraction
    start: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", fraction("period [ns]", self.period))
        if self.period < 1:
            raise BadInput(f"the period is {float(self.period):g} ns; expected at least 1")

    def at(self, beat: int) -> int:
        """Time of a beat [ns]."""
        return self.start + beat * self.period.numerator // self.period.denominator

    def times(self, first: int, count: int, stride: int = 1) -> np.ndarray:
        """Times of beats first, first + stride, … [ns], int64 (count,). Raises `BadInput` beyond `FARTHEST`."""
        if max(abs(self.at(first)), abs(self.at(first + stride * count))) > FARTHEST:
            years = FARTHEST / SECOND / (365 * 86400)
            raise BadInput(f"{count} beats from beat {first} exceed the {years:.0f} years of a table; expected fewer")
        top, bottom = self.period.numerator, self.period.denominator
        whole, rest = divmod(top, bottom)
        beats = first + stride * np.arange(count, dtype=np.int64)
        if max(bottom, rest * max(abs(first), abs(first + stride * count))) < 2**62:
            return self.start + beats * whole + beats * rest // bottom
        return np.array([self.start + beat * top // bottom for beat in beats.tolist()], np.int64)  # beyond 64 bits
