"""The interface of players: they play a schedule on machines, for a print that holds the light."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from vamgpu.hosts.frames.versions import FrameVersion, FrameVersions
from vamgpu.hosts.records.record import FrameRecord
from vamgpu.hosts.safety.light import Lamp, Switch
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.schedule import Schedule


@dataclass(frozen=True)
class StatusPoll:
    running: bool  # False after the light of the last frame
    motion: float  # error [poses]
    shown: int  # frames shown by the mirrors
    scheduled: int  # expected frames
    frames: tuple[FrameRecord, ...]  # records since the last poll, in order of slots
    position: float  # position in the schedule's unit, pose 0 at 0
    fill: float  # fill level of the buffers, 0..1
    margin: float  # duration of the frames at the mirrors [s]
    fault: str | None = None  # why a machine is not reliable
    final: bool = False  # whether the print cannot continue after that fault


class Renew(Protocol):
    def __call__(self, length: int) -> None: ...  # keep the light on for ``length`` [ns] more


def no_lease(length: int) -> None:
    """Renew nothing: no controller holds a lease."""


class Player(Protocol):
    """Machines that play one schedule."""

    clock: Clock

    @property
    def schedule(self) -> Schedule: ...  # the schedule
    @property
    def lamp(self) -> Lamp: ...  # the light
    @property
    def switches(self) -> Mapping[str, Switch]: ...  # further switches that turn the light off
    @property
    def versions(self) -> FrameVersions | None: ...  # versions of the frames; None if they stay as they are
    def renew(self, length: int) -> None: ...  # let the controller keep the light on for ``length`` [ns] more
    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """In the dark: fill buffers, bring the motion to speed ahead of a slot; returns the time to its light [ns]."""
        ...

    # data of a run segment for the run's folder, so that another host can continue
    def facts(self) -> dict[str, Any]: ...
    def start(self) -> None: ...  # start: light is allowed
    def poll(self) -> StatusPoll: ...  # read the machines
    def feed(self) -> None: ...  # after a poll: pass frames to the machines. Raises `Underrun`.
    @property
    def pending_versions(self) -> Set[int]: ...  # versions of missed frames that will be shown again
    # show a version from its turn on; False if frames of that turn are already queued
    def swap(self, version: FrameVersion) -> bool: ...
    def wait(self) -> None: ...  # return when the next poll is due
    def finish(self) -> None: ...  # end after the present frame

    def doubtful(self) -> range:
        """In the dark, before `halt`: slots that may have had a part of their light. Raises `DeviceError`."""
        ...

    def recover(self) -> None: ...  # before a print continues: reconnect to unplugged machines
    def halt(self) -> None: ...  # stop everything, even after failures; raises the first one afterwards
    def repeat(self, slots: range) -> None: ...  # show frames of a vial once more, in an added turn
    # at the end: whether slots were added for missed frames. Raises `Underrun` for too many.
    def add_repeats(self) -> bool: ...
    def frame(self, number: int, engine: int = 0) -> np.ndarray: ...  # frame for display, uint8 [row, column]
