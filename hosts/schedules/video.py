"""Schedules of a turning vial with mirrors on a video cable: every image takes a whole number of slots."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import ceil, nan

import numpy as np

from vamgpu.errors import BadInput, TimingInfeasible
from vamgpu.geometry import Turntable
from vamgpu.hosts.schedules.limits import HdmiTiming, powers
from vamgpu.hosts.schedules.mirrors import even_images
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND, Cadence, Number, below, exact, nanoseconds, whole

SAME = Fraction(1, 10**5)  # speeds this close are the same, because users write the rounded ones of messages


def vial(
    images: int | Turntable, *, speed: Number, display: HdmiTiming, turns: int = 1, power: float | Sequence[float] = 1.0
) -> Schedule:
    """Slots of a vial: ``images`` per turn at ``speed`` [deg/s], each in whole slots of the cable; see `_slots_in`."""
    number, times = whole("images", even_images(images)), whole("turns", turns)
    return _table(number, number * times, Fraction(360, number), "deg", speed, display, power)


def web_on_cable(
    poses: int, *, advance: Number, speed: Number, display: HdmiTiming, power: float | Sequence[float] = 1.0
) -> Schedule:
    """Slots of a web: frames ``advance`` [mm] apart at ``speed`` [mm/s], each in whole slots of the cable."""
    count = whole("poses", poses)
    return _table(count, count, exact("advance [mm]", advance), "mm", speed, display, power)


def _table(
    number: int, count: int, way: Fraction, unit: str, speed: Number, display: HdmiTiming,
    power: float | Sequence[float],
) -> Schedule:  # fmt: skip
    """``count`` slots of ``number`` frames, one every ``way``."""
    shares, repeats = powers(power), _slots_in(way, unit, speed, display)
    slot = SECOND / display.slot_rate
    begin = Cadence(slot * display.patterns).at(display.latency)
    beats = Cadence(slot, begin)
    light, end = beats.times(0, count, repeats), beats.times(repeats, count, repeats)
    pose, pause = np.arange(count, dtype=np.int64), nanoseconds("dark [s]", display.dark)
    cable = Cadence(slot * display.patterns)
    received = np.array([cable.at(beat) for beat in (pose * repeats // display.patterns).tolist()], np.int64)
    return Schedule(
        command=np.full(count, NONE, np.int64), trigger=received, light=light, dark=end - pause,
        on=end - light - repeats * pause, frame=pose % number, pose=pose, plane=np.zeros(count, np.int64),
        position=pose * float(way), focus=np.full(count, nan), power=np.tile(np.array(shares), (count, 1)),
        cadence=Cadence(slot * repeats, begin), advance=way, unit=unit, frames=number,
    )  # fmt: skip


def _slots_in(way: Fraction, unit: str, speed: Number, display: HdmiTiming) -> int:
    """Slots of the cable for every ``way``."""
    if not isinstance(display, HdmiTiming):
        raise BadInput(f"display is {display!r}; expected the HdmiTiming of the projector")
    wanted = exact(f"speed [{unit}/s]", speed)
    turn = way * display.slot_rate
    ratio = turn / wanted
    if ratio > 3600 * display.slot_rate:
        raise BadInput(f"{float(wanted):.4g} {unit}/s is an image in more than an hour; move faster")
    slots = max(round(ratio), 1)
    if abs(ratio - slots) <= SAME * ratio:
        return slots
    most = below(turn / max(ceil(ratio), 1))
    limit = "mirrors" if ratio < 1 else "cadence"
    each, move = (
        (f"{360 / way} images per turn", "turn") if unit == "deg" else (f"images every {float(way):.6g} mm", "move")
    )
    raise TimingInfeasible(
        f"{each} at {float(wanted):.6g} {unit}/s last {float(ratio):.6g} slots each, at "
        f"{float(display.slot_rate):.6g} slots per second; expected a whole number, or images jitter: {move} at "
        f"{most:.6g} {unit}/s, or use another number of images", limit, most, f"{unit}/s",
    )  # fmt: skip
