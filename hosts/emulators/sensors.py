"""The encoder and the index mark of an emulated motor, and their checks by the controller."""

from __future__ import annotations

from vamgpu.hosts.emulators.track import Track

RECHECK = 1_000_000  # time after which a shaft that turns back is compared again [ns]


def _times(count: int, top: int, bottom: int) -> int:
    """count · top / bottom towards zero, as C divides."""
    found = abs(count) * top // abs(bottom)
    return found if (count < 0) == (bottom < 0) else -found


class Senses:
    """Encoder and index mark of a motor, as ratios (counts, microsteps, limit); 0 counts for none."""

    encoder: tuple[int, int, int]
    index: tuple[int, int, int]
    home: int
    marks: int
    edges: tuple[int, int] = (1, 8)  # counts of the encoder, and their microsteps
    mark: tuple[int, int] = (500, 3200)  # microstep of the first mark, and microsteps from mark to mark

    def __init__(self) -> None:
        self.encoder = self.index = (0, 1, 0)
        self.home = self.marks = 0
        self.astray: bool = False
        self._since: int | None = None  # marks since the first, which was at ``_first``
        self._first = 0
        self._lost = 0  # microsteps by which the shaft lags
        self._stands: int | None = None  # position of a stalled shaft
        self._shift = 0  # microsteps of position 0 since power-on
        self._base = (0, 0)  # counts and position at which they last agreed
        self._seen, self._at = 0, 0  # the shaft, and when it was compared
        self._back: int | None = None  # time of the next comparison of a shaft that turns back

    @property
    def used(self) -> bool:
        """Whether a host has set an encoder or a mark."""
        return bool(self.encoder[0] or self.index[0])

    def shaft(self, position: int) -> int:
        """Position of the shaft [microsteps since power-on]."""
        return position + self._shift - self._lost if self._stands is None else self._stands

    def _here(self, now: int, position: int) -> None:
        self._seen, self._at = self.shaft(position), now

    def stall(self, now: int, position: int) -> None:
        """The shaft stalls from now on."""
        self._stands = self.shaft(position)
        self._here(now, position)

    def slip(self, now: int, position: int, steps: int) -> None:
        self._lost += steps
        self._here(now, position)

    def moved(self, now: int, position: int) -> None:
        """A host sets another speed, which may be backwards."""
        self._here(now, position)
        self._back = now + RECHECK

    def forget(self) -> None:
        """Clear the host's settings."""
        self.encoder = self.index = (0, 1, 0)
        self.home, self._since, self.astray = 0, None, False

    def _counts(self, position: int) -> int:
        return self.shaft(position) * self.edges[0] // self.edges[1]

    def take(self, which: str, ratio: tuple[int, int, int], now: int, position: int) -> None:
        """Set the ratio of the encoder or the mark."""
        setattr(self, which, ratio)
        self._base, self._since, self.astray = (self._counts(position), position), None, False
        self._here(now, position)

    def call_position(self, now: int, position: int, there: int) -> None:
        self._base, self.astray = (self._counts(position), there), False
        self._shift += position - there
        self._first += there - position
        self._here(now, there)

    def measured(self, position: int) -> int:
        """Position by the encoder [microsteps]."""
        counts, there = self._base
        return there + _times(self._counts(position) - counts, self.encoder[1], self.encoder[0])

    def wrong(self, position: int) -> str | None:
        """Name the sensor that disagrees with the steps."""
        if self.encoder[0] and abs(position - self.measured(position)) > self.encoder[2]:
            return "stall"
        return "index" if self.astray else None

    def _next(self) -> int:
        assert self._since is not None
        return self._first + _times(self._since + 1, self.index[1], self.index[0])

    def due(self, web: Track) -> list[int | None]:
        """Time at which the shaft passes its mark, or exceeds its allowed error."""
        times = []
        if self.encoder[0] and self._stands is not None:
            position = self._stands - self._shift + self._lost
            edge = self.measured(position) + self.encoder[2] + 1
            times.append(web.reaches(edge, self._at) if web.position(self._at) < edge else None)
        if self.index[0]:
            times.append(self._back)
            if self._stands is None:
                ahead = self.mark[0] + ((self._seen - self.mark[0]) // self.mark[1] + 1) * self.mark[1]
                times.append(web.reaches(ahead - self._shift + self._lost, self._at))
            if self._since is not None:
                times.append(web.reaches(self._next() + self.index[2] + 1, self._at))
        return times

    def compare(self, web: Track, now: int, position: int) -> tuple[str | None, int]:
        """Name the sensor that disagrees, and the number of a home that was found."""
        before = self._seen
        self._here(now, position)
        homed, back = 0, web.velocity(now) < 0
        self._back = now + RECHECK if back else None
        if back:
            self._since = None
        elif self.index[0] and (before - self.mark[0]) // self.mark[1] < (self._seen - self.mark[0]) // self.mark[1]:
            self.marks += 1
            homed, self.home = self.home, 0
            if homed or self._since is None:
                self._since, self._first = 0, position
            else:
                error, self._since = position - self._next(), self._since + 1
                self._lose(abs(error) > self.index[2])
        elif self._since is not None:
            self._lose(position > self._next() + self.index[2])
        return self.wrong(position), homed

    def _lose(self, lost: bool) -> None:
        if lost:
            self.astray, self._since = True, None

    def status(self, position: int) -> tuple[int, int, int]:
        """Values of the status: present sensors, measured position, marks."""
        which = bool(self.encoder[0]) | bool(self.index[0]) << 1 | bool(self.home) << 2 | self.astray << 3
        return which, self.measured(position) if self.encoder[0] else 0, self.marks
