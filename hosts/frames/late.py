"""What to do when a frame is not there in time: a web goes on in the dark twice and then stops, a vial turns on."""

from __future__ import annotations

from collections import Counter
from enum import Enum
from typing import Protocol

from vamgpu.hosts.schedules.timing import whole


class Action(Enum):
    """What an under-run leads to."""

    BLACK = "show black in its place"
    STOP = "light off, then stop the web"


class LatePolicy(Protocol):
    """Decides on frames that are late."""

    @property
    def stopped(self) -> str: ...  # why `drop` said stop
    def drop(self, pose: int) -> Action: ...  # count a pose whose frame is late; poses come in rising order
    # count a lost pose no more, as its slot did not come; the latest is taken back first
    def undo_drop(self, pose: int) -> None: ...
    def pending_repeats(self) -> Counter[int]: ...  # how often each frame is to be shown again


class WebLatePolicy:
    """A web must not wait, and no frame may come twice: a lost one is black, and too many end the print.

    A voxel sees about ``window`` poses; each that is lost takes one part in so many of its dose. Up to ``allowed`` lost
    poses in any window are borne. Losing several focus planes of a pose counts as one: each column is in one plane.
    """

    window: int
    allowed: int

    def __init__(self, window: int = 360, allowed: int = 2) -> None:
        self.window, self.allowed = whole("window", window), whole("allowed", allowed, 0)
        self.total: int = 0
        self._recent: Counter[int] = Counter()

    def drop(self, pose: int) -> Action:
        """Count a pose whose frame is late; poses come in rising order."""
        self.total += 1
        self._recent[pose] += 1
        self._recent = Counter({at: lost for at, lost in self._recent.items() if at > pose - self.window})
        return Action.STOP if len(self._recent) > self.allowed else Action.BLACK

    def undo_drop(self, pose: int) -> None:
        """Count a lost pose no more, as its slot did not come."""
        self.total -= 1
        self._recent -= Counter([pose])

    @property
    def stopped(self) -> str:
        """Why `drop` said stop."""
        return f"more than {self.allowed} of {self.window} poses were lost"

    def pending_repeats(self) -> Counter[int]:
        """Nothing: a web does not come round again."""
        return Counter()


class VialLatePolicy:
    """A vial comes round again: what was missed is black, the turn goes on, and added turns show it again.

    images: a turn.
    """

    def __init__(self, images: int) -> None:
        self.images: int = whole("images", images)
        self.missed: int = 0
        self._pending: Counter[int] = Counter()
        self._row = range(0)

    def drop(self, pose: int) -> Action:
        """Count a pose that black was shown for; a whole turn of them without a break ends the print."""
        self._row = range(self._row.start if pose == self._row.stop else pose, pose + 1)
        self.missed += 1
        self._pending[pose % self.images] += 1
        return Action.STOP if len(self._row) >= self.images else Action.BLACK

    def undo_drop(self, pose: int) -> None:
        """Count a lost pose no more, as its slot did not come; the latest is taken back first."""
        self._row = range(self._row.start, pose) if pose == self._row.stop - 1 else self._row
        self.missed -= 1
        self._pending[pose % self.images] -= 1

    @property
    def stopped(self) -> str:
        """Why `drop` said stop."""
        return f"the frames of a whole turn of {self.images} were lost"

    def pending_repeats(self) -> Counter[int]:
        """How often each frame is to be shown again; asking settles it."""
        pending, self._pending = +self._pending, Counter()
        return pending
