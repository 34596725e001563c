"""Schedules for triggered mirrors: webs with a moving focus, vials, slices of continuous SLA."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import nan

import numpy as np

from vamgpu.errors import BadInput, TimingInfeasible
from vamgpu.geometry import Turntable
from vamgpu.hosts.schedules.limits import LensTiming, MirrorTiming, powers
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND, Cadence, Number, below, every, exact, fraction, nanoseconds, whole
from vamgpu.printing.focus import slots

FULL = 360
NANODEGREES = 10**9  # angles are multiples of this, which files keep exactly


def rising(motion: Turntable) -> tuple[Fraction, ...]:
    """Angles [deg] of a turn, rising from 0 to below 360. Raises `BadInput` for others, and for unequal times."""
    if motion.dwell is not None:
        raise BadInput(
            f"a schedule got {motion} angles; expected frames that are lit equally long, because mirrors use one time "
            "for all: solve for a Turntable without dwell"
        )
    degrees = [Fraction(round(angle * NANODEGREES), NANODEGREES) for angle in np.degrees(motion.poses).tolist()]
    late = next((k for k in range(1, len(degrees)) if degrees[k] <= degrees[k - 1]), None)
    if late is not None or degrees[-1] - degrees[0] >= FULL:
        last, first = (degrees[late], degrees[late - 1]) if late else (degrees[-1], degrees[0])
        raise BadInput(
            f"a schedule got angles that go from {float(first):.6g}° to {float(last):.6g}°; expected them to rise "
            "within one turn: sort angles and frames, and drop repeated angles"
        )
    return tuple(angle - degrees[0] // FULL * FULL for angle in degrees)


def closest(angles: tuple[Fraction, ...]) -> Fraction:
    """The least step [deg] from one angle to the next, around the turn."""
    following = (*angles[1:], angles[0] + FULL)
    return min(after - angle for angle, after in zip(angles, following, strict=True))


def even_images(images: int | Turntable) -> int:
    """Number of equally spaced images in a turn. Raises `BadInput` for a turntable with other angles."""
    if not isinstance(images, Turntable):
        return images
    if not images.is_even:
        raise BadInput(
            f"a video cable got {images} angles; expected equal steps and times over a full turn, because its "
            "frames change at a fixed rate: solve for Turntable(angles=n), or print on triggered mirrors"
        )
    return images.angles


SLOWEST = 3600 * SECOND  # longest time of a pose [ns]
Engines = MirrorTiming | Sequence[MirrorTiming]


def web(
    poses: int, *, advance: Number, speed: Number, engines: Engines, lens: LensTiming | None = None,
    focus: Sequence[float] = (), bits: int = 8, turning: bool = True, on: Number | None = None,
    power: float | Sequence[float] = 1.0,
) -> Schedule:  # fmt: skip
    """Slots of a web or a rising platform: at each pose a frame for each focus plane, frame pose · planes + plane."""
    count, way = whole("poses", poses), exact("advance [mm]", advance)
    shown = _Engines.of(engines, bits, power)
    focus = tuple(float(fraction("focus [dpt]", each)) for each in every("focus", focus))
    planes = max(len(focus), 1)
    if lens is not None and not isinstance(lens, LensTiming):
        raise BadInput(f"lens is {lens!r}; expected a LensTiming, or None for no lens")
    if planes > 1 and lens is None:
        raise BadInput(f"{planes} focus planes and no lens; expected its LensTiming")
    order = slots(2, planes, turning=turning)
    pose = _Pose.of(order, lens if planes > 1 else None, shown, on)
    period = pose.period(way, exact("speed [mm/s]", speed), "mm")
    wait = lens.wire + lens.settling if lens is not None and focus else 0
    return _table(Cadence(period, wait), way, count, order, pose, focus, shown, lens)


def turned(
    images: int | Turntable, *, speed: Number, engines: Engines, turns: int = 1, bits: int = 8,
    on: Number | None = None, power: float | Sequence[float] = 1.0,
) -> Schedule:  # fmt: skip
    """Slots of a vial that turns at a speed [deg/s]: equally spaced images, or the angles of a `Turntable`."""
    motion = images if isinstance(images, Turntable) else None
    number = images.angles if isinstance(images, Turntable) else whole("images", images)
    times = whole("turns", turns)
    shown, order = _Engines.of(engines, bits, power), np.zeros((2, 1), np.int64)
    pose, wanted = _Pose.of(order, None, shown, on), exact("speed [deg/s]", speed)
    if motion is not None and not motion.is_even:
        return _scanned(motion, times, wanted, pose, shown.power)
    way = Fraction(360, number)
    period = pose.period(way, wanted, "deg")
    return _table(Cadence(period), way, number * times, order, pose, (), shown, None, number)


def _scanned(motion: Turntable, turns: int, speed: Fraction, pose: _Pose, power: tuple[float, ...]) -> Schedule:
    """Slots at measured angles of a turn; the two nearest are one ``advance`` apart."""
    angles = rising(motion)
    way, count = closest(angles), len(angles) * turns
    period = pose.period(way, speed, "deg")
    _, on = pose.times(period)
    turn, number = Cadence(period / way * FULL), np.arange(count, dtype=np.int64)
    after = np.array([int(angle / way * period) for angle in angles], np.int64)
    light = (turn.times(0, turns)[:, None] + after).ravel()
    return Schedule(
        command=np.full(count, NONE, np.int64), trigger=light, light=light, dark=light + on,
        on=np.full(count, on, np.int64), frame=number % len(angles), pose=number, plane=np.zeros(count, np.int64),
        position=(FULL * np.arange(turns)[:, None] + np.array([float(angle) for angle in angles])).ravel(),
        focus=np.full(count, nan), power=np.tile(np.array(power), (count, 1)),
        cadence=Cadence(period), advance=way, unit="deg", frames=len(angles),
    )  # fmt: skip


@dataclass(frozen=True)
class _Engines:
    """Mirrors in step: the longest of their times [ns]."""

    least: int
    pause: int
    power: tuple[float, ...]

    @classmethod
    def of(cls, engines: Engines, bits: int, power: float | Sequence[float]) -> _Engines:
        found = (engines,) if isinstance(engines, MirrorTiming) else every("engines", engines)
        if not found or not all(isinstance(each, MirrorTiming) for each in found):
            raise BadInput(f"engines is {engines!r}; expected a MirrorTiming, or one for each projector")
        depth = whole("bits", bits)
        least, pause = max(each.least(depth) for each in found), max(each.pause for each in found)
        return cls(least, pause, powers(power, len(found)))


@dataclass(frozen=True)
class _Pose:
    """The times of a pose [ns]: before the light of each slot at even and odd poses, and of the light."""

    gaps: np.ndarray
    moved: np.ndarray
    frame: int
    on: int | None
    shown: _Engines
    wire: int

    @classmethod
    def of(cls, order: np.ndarray, lens: LensTiming | None, shown: _Engines, on: Number | None) -> _Pose:
        before = np.roll(order.ravel(), 1).reshape(order.shape)
        moved = before != order
        gaps = np.where(moved, 0 if lens is None else lens.wire + lens.settling, 0)
        wanted = None if on is None else nanoseconds("on [s]", exact("on [s]", on))
        frame = max(shown.least, wanted or 0, 1) + shown.pause  # light lasts until the mirrors have shown all planes
        return cls(gaps, moved, frame, wanted, shown, lens.wire if lens else 0)

    @property
    def parts(self) -> dict[str, int]:
        """The parts of the longer pose's time [ns]."""
        gaps, moved = max(zip(self.gaps, self.moved, strict=True), key=lambda each: int(each[0].sum()))
        wire = int(moved.sum()) * self.wire
        held = len(gaps) * self.frame
        name = "light" if self.frame > self.shown.least else "mirrors"
        settling = int(gaps[moved].sum()) - wire
        return {"lens": settling, "serial line": wire, name: held}

    def period(self, way: Fraction, speed: Fraction, unit: str) -> Fraction:
        """Nanoseconds per pose at a speed. Raises `TimingInfeasible` if that is too short."""
        period = way / speed * SECOND
        if period > SLOWEST:
            seconds = float(period / SECOND)
            raise BadInput(f"{float(speed):.4g} {unit}/s is an angle in {seconds:.4g} s; expected at most an hour")
        parts = self.parts
        limit, need = max(parts, key=lambda name: parts[name]), sum(parts.values())
        if period < need:
            most = below(way * SECOND / need)
            spent = ", ".join(f"{1e-6 * time:.4g} ms {name}" for name, time in parts.items() if time)
            raise TimingInfeasible(
                f"{float(speed):.6g} {unit}/s leaves {1e-6 * float(period):.4g} ms per angle; {1e-6 * need:.4g} ms are "
                f"needed ({spent}): at most {most:.6g} {unit}/s; the slowest part is the {limit}",
                limit, most, f"{unit}/s",
            )  # fmt: skip
        return period

    def times(self, period: Fraction) -> tuple[np.ndarray, int]:
        """Delay of each slot's light from its pose, int64 (2, slots), and its duration [ns]."""
        room = int(period) - int(self.gaps.sum(axis=1).max())
        each = room // self.gaps.shape[1]
        starts = np.cumsum(self.gaps, axis=1) + each * np.arange(self.gaps.shape[1])
        return starts, each - self.shown.pause if self.on is None else self.on


def _table(
    cadence: Cadence, way: Fraction, poses: int, order: np.ndarray, pose: _Pose, focus: Sequence[float],
    shown: _Engines, lens: LensTiming | None, repeat: int | None = None,
) -> Schedule:  # fmt: skip
    planes, (starts, on) = order.shape[1], pose.times(cadence.period)
    begins, number = cadence.times(0, poses), np.arange(poses, dtype=np.int64)
    parity = number % 2
    light = (begins[:, None] + starts[parity]).ravel()
    plane, moved, gap = (table[parity].ravel() for table in (order, pose.moved, pose.gaps))
    command = np.where(moved, light - gap, NONE)
    if lens is not None and focus:  # from any power, the lens is on its plane before the first light
        command[0] = light[0] - lens.wire - lens.settling
    pose_number = np.repeat(number, planes)
    return Schedule(
        command=command, trigger=light, light=light, dark=light + on,
        on=np.full(light.size, on, np.int64),
        frame=(pose_number if repeat is None else pose_number % repeat) * planes + plane, pose=pose_number, plane=plane,
        position=pose_number * float(way), focus=np.array(focus)[plane] if focus else np.full(light.size, nan),
        power=np.tile(np.array(shown.power), (light.size, 1)),
        cadence=cadence, advance=way, unit="mm" if repeat is None else "deg",
        frames=(poses if repeat is None else repeat) * planes,
    )  # fmt: skip
