"""The encoder and the index mark of an emulated motor, and what the controller makes of them."""

from __future__ import annotations

from vamgpu.hosts.emulators.track import Track

RECHECK = 1_000_000  # after which a shaft that turns back is compared again [ns]


def _times(count: int, top: int, bottom: int) -> int:
    """count · top / bottom towards zero, as C divides."""
    found = abs(count) * top // abs(bottom)
    return found if (count < 0) == (bottom < 0) else -found


class Senses:
    """Encoder and index mark of a motor, by ratios (counts, microsteps, limit); 0 counts: there is none."""

    encoder: tuple[int, int, int]
    index: tuple[int, int, int]
    home: int
    marks: int
    edges: tuple[int, int] = (1, 8)  # counts of the encoder, in so many microsteps
    mark: tuple[int, int] = (500, 3200)  # microstep of the first mark, and microsteps from mark to mark

    def __init__(self) -> None:
        self.encoder = self.index = (0, 1, 0)
        self.home = self.marks = 0
        self.astray: bool = False
        self._since: int | None = None  # marks since the first, which was at ``_first``
        self._first = 0
        self._lost = 0  # microsteps that the shaft is behind
        self._stands: int | None = None  # where a shaft stands that does not turn
        self._shift = 0  # of position 0, since power came
        self._base = (0, 0)  # counts and position where they were last taken to agree
        self._seen, self._at = 0, 0  # the shaft, and when it was compared
        self._back: int | None = None  # when one that turns back is compared again

    @property
    def used(self) -> bool:
        """Whether a host set an encoder or a mark."""
        return bool(self.encoder[0] or self.index[0])

    def shaft(self, position: int) -> int:
        """Where the shaft is [microsteps since power came]."""
        return position + self._shift - self._lost if self._stands is None else self._stands

    def _here(self, now: int, position: int) -> None:
        self._seen, self._at = self.shaft(position), now

    def stall(self, now: int, position: int) -> None:
        """The shaft stands from now on."""
        self._stands = self.shaft(position)
        self._here(now, position)

    def slip(self, now: int, position: int, steps: int) -> None:
        """The shaft falls behind."""
        self._lost += steps
        self._here(now, position)

    def moved(self, now: int, position: int) -> None:
        """A host tells another speed, which may be backwards."""
        self._here(now, position)
        self._back = now + RECHECK

    def forget(self) -> None:
        """Forget what a host set."""
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
        """Position ``position`` is called ``there``."""
        self._base, self.astray = (self._counts(position), there), False
        self._shift += position - there
        self._first += there - position
        self._here(now, there)

    def measured(self, position: int) -> int:
        """Where the encoder says that it is [microsteps]."""
        counts, there = self._base
        return there + _times(self._counts(position) - counts, self.encoder[1], self.encoder[0])

    def wrong(self, position: int) -> str | None:
        """Name the sense that disagrees with the steps."""
        if self.encoder[0] and abs(position - self.measured(position)) > self.encoder[2]:
            return "stall"
        return "index" if self.astray else None

    def _next(self) -> int:
        assert self._since is not None
        return self._first + _times(self._since + 1, self.index[1], self.index[0])

    def due(self, web: Track) -> list[int | None]:
        """When the shaft passes its mark, or is too far from where it should be."""
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
        """Name the sense that disagrees, and the number of a home that was found."""
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
        """Values of the status: which senses there are, the measured position, marks."""
        which = bool(self.encoder[0]) | bool(self.index[0]) << 1 | bool(self.home) << 2 | self.astray << 3
        return which, self.measured(position) if self.encoder[0] else 0, self.marks
