"""The interface of players: they play a schedule on machines, under a print that holds the light."""

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
    """State of the machines at a status poll."""

    running: bool  # False once the light of the last frame is over
    motion: float  # error [poses]
    shown: int  # frames that the mirrors showed
    scheduled: int  # frames that they should have shown
    frames: tuple[FrameRecord, ...]  # since the last poll, slots rising
    position: float  # in the schedule's unit, pose 0 at 0
    fill: float  # of the buffers, 0..1
    margin: float  # how long the frames at the mirrors last [s]
    fault: str | None = None  # why a machine cannot be trusted
    final: bool = False  # whether no print can go on after that fault


class Renew(Protocol):
    """Renews a lease."""

    def __call__(self, length: int) -> None: ...  # keep the light for ``length`` [ns] more


class Player(Protocol):
    """Machines that play one schedule."""

    clock: Clock

    @property
    def schedule(self) -> Schedule: ...  # what is played
    @property
    def lamp(self) -> Lamp: ...  # the light
    @property
    def switches(self) -> Mapping[str, Switch]: ...  # further ways to make it dark
    @property
    def versions(self) -> FrameVersions | None: ...  # versions of the frames; None where these stay as they are
    def renew(self, length: int) -> None: ...  # let the controller keep the light for ``length`` [ns] more
    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """In the dark: fill buffers, bring the motion to speed ahead of a slot; returns the time to its light [ns]."""
        ...

    # what a run's folder keeps of a run segment, so that another host can go on with it
    def facts(self) -> dict[str, Any]: ...
    def start(self) -> None: ...  # light is allowed: begin
    def poll(self) -> StatusPoll: ...  # see what the machines did
    def feed(self) -> None: ...  # after a poll: hand frames on to the machines. Raises `Underrun`.
    @property
    def pending_versions(self) -> Set[int]: ...  # versions of frames that were missed and are to be shown again
    # show a version from its turn on; False where frames of that turn are on their way already
    def swap(self, version: FrameVersion) -> bool: ...
    def wait(self) -> None: ...  # return when the next poll is due
    def finish(self) -> None: ...  # end after the frame that is on its way

    def doubtful(self) -> range:
        """In the dark, before `halt`: slots that may have had a part of their light. Raises `DeviceError`."""
        ...

    def recover(self) -> None: ...  # before a print goes on: reach again machines that were unplugged
    def halt(self) -> None: ...  # bring all to rest, come what may; raises the first failure afterwards
    # at the end: whether slots were added for frames that were missed. Raises `Underrun` for too many.
    def add_repeats(self) -> bool: ...
    def frame(self, number: int, engine: int = 0) -> np.ndarray: ...  # for people, uint8 [row, column]
