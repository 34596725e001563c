"""Which slots of a video cable were lit, for how long and how late, from where the stage is after each video frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import floor

from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.timing import SECOND

ASIDE = 0.75
"""How far the stage may be from the count of slots before that is corrected; below, no image loses a slot [slots]."""


@dataclass(frozen=True)
class Light:
    """Light of some slots. times: slots of light, more than one for a slot that a screen repeated.  late: the most that
    one came after the stage was at its angle [ns].  missing: slots that were not shown.
    """

    times: int
    late: int
    missing: tuple[int, ...]


class Lit:
    """Counts slots by the stage, and remembers what was sent for them until it is taken.

    begins: slot that begins at the last refresh; None before the stage was seen.  A count that is near enough goes on
    evenly, so that an angle at the edge between two slots does not jump to and fro.
    """

    def __init__(self, display: HdmiTiming) -> None:
        self._patterns, self._ahead = display.patterns, display.latency * display.patterns
        self._slot = float(SECOND / display.slot_rate)
        self._frames: deque[tuple[int, tuple[int, ...]]] = deque([(0, ()), (0, ())], maxlen=2)
        self._times: dict[int, int] = {}
        self._late: dict[int, int] = {}
        self.begins: int | None = None

    def saw(self, slots: float, since: int) -> None:
        """Take the stage's word. slots: where it was at the last refresh.  since: refreshes after the last frame's."""
        nearest = floor(slots + 0.5)
        expected = nearest if self.begins is None else self.begins + self._patterns
        self.begins = expected if abs(slots - expected) <= ASIDE else nearest
        slipped = max((self.begins - expected) // self._patterns, 0)
        (_, before), (first, last) = self._frames
        for sent, repeated in ((before, max(slipped - since, 0)), (last, since)):
            for slot in sent:  # a screen repeats the frame that none has replaced
                if slot in self._times:
                    self._times[slot] += repeated
        behind = slots - since * self._patterns + self._ahead - first
        self._late |= {slot: round(behind * self._slot) for slot in last if slot in self._times}

    def next(self) -> range:
        """The slots of the next video frame: it goes out at the next refresh and is lit ``latency`` later."""
        first = (self.begins or 0) + self._patterns + self._ahead
        return range(first, first + self._patterns)

    def sent(self, first: int, slots: Sequence[int]) -> None:
        """A video frame for slots from ``first`` on has pictures for ``slots``, and black for the others."""
        self._frames.append((first, tuple(slots)))
        self._times |= dict.fromkeys(slots, 1)

    def take(self, slots: Sequence[int]) -> Light:
        """What became of slots that the stage is past; they are forgotten."""
        late = max((self._late.pop(slot, 0) for slot in slots), default=0)
        missing = tuple(slot for slot in slots if slot not in self._times)
        return Light(sum(self._times.pop(slot, 0) for slot in slots), late, missing)
