"""Policies for late frames: a web may miss a few poses before it stops, a vial adds turns."""

from __future__ import annotations

from collections import Counter
from typing import Protocol

from vamgpu.hosts.schedules.timing import whole


class LatePolicy(Protocol):
    @property
    def stopped(self) -> str: ...  # why `drop` ended the print
    def drop(self, pose: int) -> bool: ...  # count a pose with a late frame, in rising order; whether the print ends
    # uncount a lost pose whose slot did not come, the latest first
    def undo_drop(self, pose: int) -> None: ...
    def pending_repeats(self) -> Counter[int]: ...  # number of repeats due for each frame; the count restarts


class WebLatePolicy:
    """A web cannot wait: a late frame is black, and more than ``allowed`` lost poses in ``window`` end the print."""

    def __init__(self, window: int = 360, allowed: int = 2) -> None:
        self.window: int = whole("window", window)
        self.allowed: int = whole("allowed", allowed, 0)
        self._recent: Counter[int] = Counter()

    def drop(self, pose: int) -> bool:
        self._recent[pose] += 1
        self._recent = Counter({at: lost for at, lost in self._recent.items() if at > pose - self.window})
        return len(self._recent) > self.allowed

    def undo_drop(self, pose: int) -> None:
        self._recent -= Counter([pose])

    @property
    def stopped(self) -> str:
        return f"more than {self.allowed} of {self.window} angles were lost"

    def pending_repeats(self) -> Counter[int]:
        """Nothing: a web has no further turn."""
        return Counter()


class VialLatePolicy:
    """A vial has further turns: a late frame is black, and repeated in an added turn. images: number per turn."""

    def __init__(self, images: int) -> None:
        self.images: int = whole("images", images)
        self._pending: Counter[int] = Counter()
        self._row = range(0)

    def drop(self, pose: int) -> bool:
        """Count a pose that was black; a whole turn of them without a break ends the print."""
        self._row = range(self._row.start if pose == self._row.stop else pose, pose + 1)
        self._pending[pose % self.images] += 1
        return len(self._row) >= self.images

    def undo_drop(self, pose: int) -> None:
        self._row = range(self._row.start, pose) if pose == self._row.stop - 1 else self._row
        self._pending[pose % self.images] -= 1

    @property
    def stopped(self) -> str:
        return f"the frames of a whole turn of {self.images} were lost"

    def pending_repeats(self) -> Counter[int]:
        pending, self._pending = +self._pending, Counter()
        return pending


class Repeats:
    """Frames of one projector that were black, their versions, and their number of repeats."""

    def __init__(self, policy: LatePolicy) -> None:
        self.policy = policy
        self.missed: set[int] = set[int]()
        self._due: Counter[int] = Counter()
        self._versions: dict[int, list[int]] = {}

    def miss(self, frame: int, version: int) -> None:
        """Record the version of a frame that was black and will be repeated."""
        self._versions.setdefault(frame, []).append(version)
        self.missed.add(version)

    def collect(self) -> Counter[int]:
        """The due repeats, with those that the policy has counted since."""
        self._due += self.policy.pending_repeats()
        return self._due

    def version(self, frame: int, last: int) -> int:
        """The version of a frame's next repeat; ``last`` if none was recorded."""
        return (self._versions.get(frame) or [last]).pop(0)

    def added(self) -> None:
        """Record an added turn that repeats each frame once."""
        self._due -= Counter(list(self._due))
