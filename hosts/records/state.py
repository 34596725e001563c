"""The state of a print and its changes, and the board that shows it and takes an operator's orders."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np

from vamgpu.errors import VamError
from vamgpu.hosts.drivers.cleanup import all_of
from vamgpu.printing.scatter import ScatterReading


class WrongState(VamError, RuntimeError):
    """The state of the print does not allow a request."""


class PrintState(StrEnum):
    STANDBY = "standby"
    PRINTING = "printing"
    PAUSED = "paused"
    HELD = "held"  # dark for a temporary reason; it can continue
    COMPLETE = "complete"  # every frame has its light
    INCOMPLETE = "incomplete"  # ended with underexposed frames
    CANCELLED = "cancelled"
    ERROR = "error"  # it cannot continue

    @property
    def ended(self) -> bool:
        return not NEXT[self]

    @property
    def waits(self) -> bool:
        """Whether it is dark and can continue."""
        return self in (PrintState.PAUSED, PrintState.HELD)


_ENDS = frozenset((PrintState.CANCELLED, PrintState.ERROR))
_ALL_SHOWN = frozenset((PrintState.COMPLETE, PrintState.INCOMPLETE))
NEXT: dict[PrintState, frozenset[PrintState]] = {
    PrintState.STANDBY: _ENDS | {PrintState.PRINTING, PrintState.HELD},
    PrintState.PRINTING: _ENDS | {PrintState.PAUSED, PrintState.HELD, *_ALL_SHOWN},
    PrintState.PAUSED: _ENDS | {PrintState.PRINTING, PrintState.HELD},
    PrintState.HELD: _ENDS | {PrintState.PRINTING, PrintState.HELD, *_ALL_SHOWN},
    **dict.fromkeys(_ENDS | _ALL_SHOWN, frozenset()),
}
"""States that may follow each state. An error may follow any state before the end; nothing follows an end."""


@dataclass(frozen=True)
class StateChange:
    """A step from one state to another, and why."""

    before: PrintState
    after: PrintState
    message: str


class PrintStates:
    """The state of one print. Any thread may change it; listeners are called in order, in that thread."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self.state: PrintState = PrintState.STANDBY
        self.message: str = ""  # the reason for the state
        self._listeners: list[Callable[[StateChange], None]] = []

    def listen(self, listener: Callable[[StateChange], None]) -> None:
        """Call a listener for every change from now on."""
        with self._lock:
            self._listeners.append(listener)

    def to(self, state: PrintState, message: str = "") -> bool:
        """Change to ``state``; False if it is the present one. Raises `WrongState` if the change is not allowed."""
        with self._lock:
            before = self.state
            if state is before and (message == self.message or state is not PrintState.HELD):
                return False
            if state not in NEXT[before]:
                ways = ", ".join(sorted(each.value for each in NEXT[before])) or "nothing; start another print"
                raise WrongState(f"the print is {before.value} and cannot become {state.value}; from here: {ways}")
            self.state, self.message = state, message
            for listener in tuple(self._listeners):
                listener(StateChange(before, state, message))
            return True

    def end(self, state: PrintState, message: str = "") -> bool:
        """Change to an end state; an earlier end, and its reason, stay."""
        with self._lock:
            return not self.state.ended and self.to(state, message)


@dataclass(frozen=True)
class Estimated:
    name: str  # name with unit
    value: float
    error: float  # standard deviation
    usual: tuple[float, float] | None = None  # range expected before the print


@dataclass(frozen=True)
class ImageCheck:
    """A check of a turn's images against the light shown; beyond its limit, images are not used."""

    name: str  # what is compared
    turn: int  # turns shown so far
    value: float
    limit: float


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A print in its present state."""

    state: PrintState = PrintState.STANDBY
    message: str = ""
    job: str = ""
    slot: int = 0
    slots: int = 0  # 0 without an end
    period: int = 0  # slots of a turn; 0 where nothing turns
    frame: int = -1  # frame shown now
    position: float = 0.0
    unit: str = "deg"
    focus: float | None = None  # power of the lens [1/m]; None without one
    fill: float = 0.0  # fill level of the buffers, 0..1
    margin: int = 0  # time left when the last frame was ready [ns]
    light: bool = False
    power: float = 0.0
    dark: int = 0  # frames replaced by black
    spent: float = 0.0  # used share of the budget of light
    preview: np.ndarray | None = None  # uint8 [row, column]
    others: tuple[np.ndarray, ...] = ()  # previews of further projectors
    left: float | None = None  # time to the end, without pauses [s]
    resuming: bool = False  # whether it prepares to continue
    deadline: float | None = None  # time until which it can continue, by `time.monotonic` [s]
    lease: float | None = None  # time for which the controller keeps the light on without the host [s]
    renewed: float | None = None  # age of the last renewal when polled [s]
    polled: float | None = None  # by `time.monotonic` [s]
    interlock_closed: bool | None = None  # read in the dark; None: unknown
    lens_temperature: float | None = None  # [degC], read in the dark; None: unknown
    camera: np.ndarray | None = None  # last image of the camera
    scatter: Sequence[ScatterReading] = ()  # oldest first; may grow
    threshold: float | None = None  # scatter density that stops the print
    plan: int = 0  # version of the coming frames
    stop: int | None = None  # turn before which the light ends
    parameters: Sequence[Estimated] = ()  # parameters of live estimation
    maps: Mapping[str, np.ndarray] = field(default_factory=dict)  # uint8 [row, column, color] by name
    live: str = ""  # state of the planning process
    checks: Sequence[ImageCheck] = ()  # oldest first
    doubt: Sequence[Sequence[int]] = ()  # first and stop of slots that were lit for an unknown time
    rehearsed: bool = False  # whether the machines are emulated
    guarantees: Sequence[Mapping[str, Any]] = ()  # what the rig guarantees, as in the record of the run


class Board:
    """The newest snapshot, and the buttons. The printing thread replaces one reference; readers never block it."""

    draws_previews = True  # whether the printing process draws its frames

    def __init__(self, **fields: object) -> None:
        self._lock = threading.RLock()  # a signal may turn the light off, and show it, during another change
        self.now: Snapshot = Snapshot(**fields)  # type: ignore[arg-type]
        self._stops: list[Callable[[str], None]] = []
        self._stopped: str | None = None
        self._buttons: dict[str, Callable[[], None]] = {}

    def show(self, **fields: object) -> None:
        """Change fields of the snapshot."""
        with self._lock:
            self.now = Snapshot(**(vars(self.now) | fields))  # type: ignore[arg-type]

    def on_stop(self, stop: Callable[[str], None]) -> None:
        """Add a function for an emergency stop, called in this order: the light first. An earlier stop is not lost."""
        self._stops.append(stop)
        if self._stopped is not None:
            stop(self._stopped)

    def stop(self, why: str) -> None:
        """Emergency stop in the caller's thread, without waiting for a poll; tries every switch, even after errors."""
        self._stopped = why
        all_of(*(partial(stop, why) for stop in self._stops))

    def button(self, name: str, press: Callable[[], None]) -> None:
        """Add a button: start, pause, resume or cancel."""
        self._buttons[name] = press

    @property
    def buttons(self) -> dict[str, Callable[[], None]]:
        return dict(self._buttons)
