"""Positions over time: pieces of constant acceleration, stored for queries of the past."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, replace
from math import inf, sqrt

SECOND = 1_000_000_000
FOREVER = 1e9  # longer times [s] count as never


@dataclass(frozen=True)
class MotionPiece:
    """A motion from ``start`` [ns] on: position, velocity [1/s] and acceleration [1/s2]."""

    start: int
    position: float
    velocity: float
    acceleration: float = 0.0

    def at(self, now: int) -> tuple[float, float]:
        """Position and velocity at a time [ns]."""
        t = (now - self.start) / SECOND
        return (
            self.position + self.velocity * t + 0.5 * self.acceleration * t * t,
            self.velocity + self.acceleration * t,
        )


class Track:
    """The motion of one axis; its last pieces are stored."""

    def __init__(self, acceleration: float) -> None:
        self.acceleration: float = acceleration
        self._pieces: deque[MotionPiece] = deque([MotionPiece(0, 0.0, 0.0)], maxlen=4096)
        self.settled_at: int = 0
        self._reached: tuple[int, float, int | None] = (0, -inf, None)  # last result of `reaches`, and its arguments

    def _piece(self, now: int) -> MotionPiece:
        if now >= self._pieces[-1].start:
            return self._pieces[-1]
        index = bisect_right(self._pieces, now, key=lambda piece: piece.start)
        return self._pieces[max(index - 1, 0)]

    def position(self, now: int) -> float:
        """Position of the axis at a time [ns], past or planned."""
        return self._piece(now).at(now)[0]

    def velocity(self, now: int) -> float:
        """Velocity of the axis [1/s]."""
        return self._piece(now).at(now)[1]

    def moving(self, now: int) -> bool:
        """Whether the axis moves, or is going to."""
        return now < self.settled_at or self.velocity(now) != 0.0

    def _replan(self, now: int, pieces: list[MotionPiece]) -> None:
        while len(self._pieces) > 1 and self._pieces[-1].start >= now:
            self._pieces.pop()
        self._pieces.extend(pieces)
        self.settled_at = pieces[-1].start
        self._reached = (0, -inf, None)

    def set_position(self, now: int, position: float) -> None:
        """Set the present position to ``position``; its motion, planned or in progress, stays."""
        under_way = self._piece(now)
        shift = position - under_way.at(now)[0]
        later = [replace(piece, position=piece.position + shift) for piece in self._pieces if piece.start > now]
        self._replan(now, [MotionPiece(now, position, under_way.at(now)[1], under_way.acceleration), *later])

    def run(self, now: int, velocity: float) -> None:
        """Change to a velocity [1/s] with the axis's acceleration, and keep it."""
        position, speed = self._piece(now).at(now)
        self._replan(now, self._ramp(now, position, speed, velocity))

    def ramp(self, now: int, acceleration: float) -> None:
        """Change the acceleration [1/s2]; a change of velocity in progress continues with it."""
        self.acceleration = acceleration
        self.run(now, self._pieces[-1].velocity)

    def _ramp(self, now: int, position: float, speed: float, velocity: float) -> list[MotionPiece]:
        duration = abs(velocity - speed) / self.acceleration
        if duration == 0:
            return [MotionPiece(now, position, velocity)]
        ramp = MotionPiece(now, position, speed, (velocity - speed) / duration)
        end = now + max(round(duration * SECOND), 1)
        return [ramp, MotionPiece(end, ramp.at(end)[0], velocity)]

    def go(self, now: int, target: float, speed: float) -> None:
        """Move to ``target`` with at most ``speed`` [1/s], from rest to rest; a moving axis stops first."""
        pieces = []
        position, velocity = self._piece(now).at(now)
        if velocity:
            pieces = self._ramp(now, position, velocity, 0.0)
            now, position = pieces[-1].start, pieces[-1].position
        distance = target - position
        sign = 1.0 if distance >= 0 else -1.0
        top = min(speed, sqrt(abs(distance) * self.acceleration))
        if top > 0:
            rise = top / self.acceleration
            cruise = abs(distance) / top - rise
            middle = now + round(rise * SECOND)
            fall = middle + round(cruise * SECOND)
            end = fall + round(rise * SECOND)
            pieces.append(MotionPiece(now, position, 0.0, sign * self.acceleration))
            pieces.append(MotionPiece(middle, position + sign * top * rise / 2, sign * top))
            pieces.append(MotionPiece(fall, target - sign * top * rise / 2, sign * top, -sign * self.acceleration))
            now = end
        pieces.append(MotionPiece(now, target, 0.0))
        self._replan(pieces[0].start, pieces)

    def reaches(self, target: float, after: int) -> int | None:
        """Time at which the axis first reaches ``target`` [ns], moving up, from ``after`` on; None if it never does."""
        if self._reached[:2] != (after, target):  # clocks query their machines repeatedly
            self._reached = (after, target, self._reaches(target, after))
        return self._reached[2]

    def _reaches(self, target: float, after: int) -> int | None:
        if self.position(after) >= target:
            return after
        pieces = [self._piece(after), *(piece for piece in self._pieces if piece.start > after)]
        for index, piece in enumerate(pieces):
            if piece.start > after and piece.position >= target:  # it was set so, or is a crossing within rounding
                return piece.start
            end = pieces[index + 1].start if index + 1 < len(pieces) else None
            found = self._crossing(piece, target)
            if found is not None and found >= after and (end is None or found < end):
                return found
        return None

    @staticmethod
    def _crossing(piece: MotionPiece, target: float) -> int | None:
        """Time at which one piece rises to a target [ns]."""
        missing, v, a = target - piece.position, piece.velocity, piece.acceleration
        if a == 0:
            return None if v * FOREVER <= missing else piece.start + -(-round(missing / v * SECOND * 1000) // 1000)
        inside = v * v + 2 * a * missing
        if inside < 0 or v + sqrt(inside) == 0:
            return None
        seconds = 2 * missing / (v + sqrt(inside))
        return piece.start + -(-round(seconds * SECOND * 1000) // 1000) if 0 <= seconds <= FOREVER else None
