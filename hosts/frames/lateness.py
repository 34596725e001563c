"""Policies for late frames: a web goes on in the dark twice and then stops, a vial turns on."""

from __future__ import annotations

from collections import Counter
from enum import Enum
from typing import Protocol

from vamgpu.hosts.schedules.timing import whole


class Action(Enum):
    """Consequence of a late frame."""

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
    """A web cannot wait: a late frame is black; more than ``allowed`` lost poses in ``window`` end the print."""

    window: int
    allowed: int

    def __init__(self, window: int = 360, allowed: int = 2) -> None:
        self.window, self.allowed = whole("window", window), whole("allowed", allowed, 0)
        self._recent: Counter[int] = Counter()

    def drop(self, pose: int) -> Action:
        """Count a pose whose frame is late; poses come in rising order."""
        self._recent[pose] += 1
        self._recent = Counter({at: lost for at, lost in self._recent.items() if at > pose - self.window})
        return Action.STOP if len(self._recent) > self.allowed else Action.BLACK

    def undo_drop(self, pose: int) -> None:
        """Count a lost pose no more, as its slot did not come."""
        self._recent -= Counter([pose])

    @property
    def stopped(self) -> str:
        """Why `drop` said stop."""
        return f"more than {self.allowed} of {self.window} poses were lost"

    def pending_repeats(self) -> Counter[int]:
        """Nothing: a web does not come round again."""
        return Counter()


class VialLatePolicy:
    """A vial comes round again: a late frame is black and repeated in an added turn. images: a turn."""

    def __init__(self, images: int) -> None:
        self.images: int = whole("images", images)
        self._pending: Counter[int] = Counter()
        self._row = range(0)

    def drop(self, pose: int) -> Action:
        """Count a pose that black was shown for; a whole turn of them without a break ends the print."""
        self._row = range(self._row.start if pose == self._row.stop else pose, pose + 1)
        self._pending[pose % self.images] += 1
        return Action.STOP if len(self._row) >= self.images else Action.BLACK

    def undo_drop(self, pose: int) -> None:
        """Count a lost pose no more, as its slot did not come; the latest is taken back first."""
        self._row = range(self._row.start, pose) if pose == self._row.stop - 1 else self._row
        self._pending[pose % self.images] -= 1

    @property
    def stopped(self) -> str:
        """Why `drop` said stop."""
        return f"the frames of a whole turn of {self.images} were lost"

    def pending_repeats(self) -> Counter[int]:
        """Number of repeats due for each frame; the count starts anew."""
        pending, self._pending = +self._pending, Counter()
        return pending


class Repeats:
    """Frames of one projector that were black, their versions, and how often they are to be shown again."""

    policy: LatePolicy
    missed: set[int]

    def __init__(self, policy: LatePolicy) -> None:
        self.policy, self.missed = policy, set[int]()
        self._due: Counter[int] = Counter()
        self._versions: dict[int, list[int]] = {}

    def miss(self, frame: int, version: int) -> None:
        """Note the version of a frame that was black and comes round again."""
        self._versions.setdefault(frame, []).append(version)
        self.missed.add(version)

    def collect(self) -> Counter[int]:
        """The repeats that are due, those that the policy counted since included."""
        self._due += self.policy.pending_repeats()
        return self._due

    def version(self, frame: int, last: int) -> int:
        """The version of which a frame is repeated next; ``last`` where none was noted."""
        return (self._versions.get(frame) or [last]).pop(0)

    def added(self) -> None:
        """A turn was added that repeats each frame once."""
        self._due -= Counter(list(self._due))
