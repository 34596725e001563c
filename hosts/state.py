"""The state of a print and how it may change, and the board that shows it and takes an operator's orders."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from vamgpu.errors import VamError
from vamgpu.printing.scatter import ScatterReading


class WrongState(VamError, RuntimeError):
    """A print was asked for something that its state does not allow."""


class PrintState(StrEnum):
    """Where a print is.

    HELD: something that may pass made it dark, and it can go on.  COMPLETE: every view has its light.  INCOMPLETE: it
    came to its end, and some views lack light.  ERROR: it cannot go on.
    """

    STANDBY = "standby"
    PRINTING = "printing"
    PAUSED = "paused"
    HELD = "held"
    COMPLETE = "complete"
    INCOMPLETE = "incomplete"
    CANCELLED = "cancelled"
    ERROR = "error"

    @property
    def ended(self) -> bool:
        """Whether nothing follows but another print."""
        return self in (PrintState.COMPLETE, PrintState.INCOMPLETE, PrintState.CANCELLED, PrintState.ERROR)

    @property
    def waits(self) -> bool:
        """Whether it is dark and can go on."""
        return self in (PrintState.PAUSED, PrintState.HELD)


_ENDS = frozenset((PrintState.CANCELLED, PrintState.ERROR))
_ALL_SHOWN = frozenset((PrintState.COMPLETE, PrintState.INCOMPLETE))
NEXT: dict[PrintState, frozenset[PrintState]] = {
    PrintState.STANDBY: _ENDS | {PrintState.PRINTING, PrintState.HELD},
    PrintState.PRINTING: _ENDS | {PrintState.PAUSED, PrintState.HELD, *_ALL_SHOWN},
    PrintState.PAUSED: _ENDS | {PrintState.PRINTING, PrintState.HELD},
    PrintState.HELD: _ENDS | {PrintState.PRINTING, PrintState.HELD, *_ALL_SHOWN},
    PrintState.COMPLETE: frozenset(),
    PrintState.INCOMPLETE: frozenset(),
    PrintState.CANCELLED: frozenset(),
    PrintState.ERROR: frozenset(),
}
"""What may follow each state. An error may follow everything that has not ended; nothing follows an end."""


@dataclass(frozen=True)
class StateChange:
    """A step from one state to another, and why."""

    before: PrintState
    after: PrintState
    message: str


class PrintStates:
    """The state of one print. Any thread may ask for a change; listeners hear of each, in order, in that thread."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._state = PrintState.STANDBY
        self._message = ""
        self._listeners: list[Callable[[StateChange], None]] = []

    @property
    def state(self) -> PrintState:
        """Where the print is now."""
        return self._state

    @property
    def message(self) -> str:
        """Why it is there."""
        return self._message

    def listen(self, listener: Callable[[StateChange], None]) -> None:
        """Hear of every change from now on."""
        with self._lock:
            self._listeners.append(listener)

    def to(self, state: PrintState, message: str = "") -> bool:
        """Go to ``state``; False where the print is there already. Raises `WrongState` where no way leads there."""
        with self._lock:
            before = self._state
            if state is before and (message == self._message or state is not PrintState.HELD):
                return False
            if state not in NEXT[before]:
                ways = ", ".join(sorted(each.value for each in NEXT[before])) or "nothing; begin another print"
                raise WrongState(f"the print is {before.value} and cannot become {state.value}; from here: {ways}")
            self._state, self._message = state, message
            for listener in tuple(self._listeners):
                listener(StateChange(before, state, message))
            return True

    def end(self, state: PrintState, message: str = "") -> bool:
        """Go to an end unless one was reached before: the first end, and its reason, stay."""
        with self._lock:
            return not self._state.ended and self.to(state, message)


@dataclass(frozen=True)
class Estimated:
    """A parameter of a print as it is estimated: its name, with its unit, its value, and one standard deviation.

    usual: between which it was expected to lie before anything was seen; None where nobody knows.
    """

    name: str
    value: float
    error: float
    usual: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A print as it is now.

    slot, slots: how far it is, and of how many; 0 where there is no end.  frame: the frame shown.  position: of the
    stage or web, with ``unit``.  focus: of the lens [1/m], None without one.  fill: of the buffers of frames, 0..1.
    margin: time left when the last frame was ready [ns].  light: whether it is on.  power: of the light.  dark:
    frames that black stood for.  spent: share of the budget of light.  preview: of the frame, uint8
    [row, column], None at first.  others: those of further projectors.  left: time to the end, without pauses [s].
    resuming: whether one that was dark gets ready to go on.  deadline: until when a print that is dark can go on, by
    `time.monotonic` [s].
    lease: how long the controller keeps the light by itself [s]; None for a print that did not begin.  renewed: how
    old its last renewal was at the last look at the machines [s].  polled: when that was, by `time.monotonic` [s].
    interlock_closed: None where nobody knows.  lens_temperature: None where the lens tells none [degC]; both are asked
    in the dark.  camera: its last image.  scatter: readings of the resin, oldest first; may grow.  threshold: that
    stops the print.  plan: version of the frames that coming turns show.  stop: the turn before which the light is to
    end; None for all.  parameters: what live estimation believes.  maps: pictures of it by name, uint8
    [row, column, color].  live: what became of the process that estimates and
    plans.
    """

    state: PrintState = PrintState.STANDBY
    message: str = ""
    job: str = ""
    slot: int = 0
    slots: int = 0
    frame: int = -1
    position: float = 0.0
    unit: str = "deg"
    focus: float | None = None
    fill: float = 0.0
    margin: int = 0
    light: bool = False
    power: float = 0.0
    dark: int = 0
    spent: float = 0.0
    preview: np.ndarray | None = None
    others: tuple[np.ndarray, ...] = ()
    left: float | None = None
    resuming: bool = False
    deadline: float | None = None
    lease: float | None = None
    renewed: float | None = None
    polled: float | None = None
    interlock_closed: bool | None = None
    lens_temperature: float | None = None
    camera: np.ndarray | None = None
    scatter: Sequence[ScatterReading] = ()
    threshold: float | None = None
    plan: int = 0
    stop: int | None = None
    parameters: Sequence[Estimated] = ()
    maps: Mapping[str, np.ndarray] = field(default_factory=dict)
    live: str = ""


class Board:
    """The newest snapshot, and the buttons. Writing costs the printing thread one reference; readers never block it."""

    pictures = True
    """Whether the process that prints draws frames for it."""

    def __init__(self, **fields: object) -> None:
        self._lock = threading.RLock()  # a signal may put the light out, and tell it, in the midst of telling
        self._now = Snapshot(**fields)  # type: ignore[arg-type]
        self._stops: list[Callable[[str], None]] = []
        self._stopped: str | None = None
        self._buttons: dict[str, Callable[[], None]] = {}

    @property
    def now(self) -> Snapshot:
        """The newest snapshot."""
        return self._now

    def show(self, **fields: object) -> None:
        """Change fields of the snapshot."""
        with self._lock:
            self._now = Snapshot(**(vars(self._now) | fields))  # type: ignore[arg-type]

    def on_stop(self, stop: Callable[[str], None]) -> None:
        """What an emergency stop calls, in the order of telling: the light first. One that came before is not lost."""
        self._stops.append(stop)
        if self._stopped is not None:
            stop(self._stopped)

    def stop(self, why: str) -> None:
        """Emergency stop in the caller's thread, which waits for no print to poll; all are called, come what may."""
        self._stopped = why
        failed: list[Exception] = []
        for stop in tuple(self._stops):
            try:
                stop(why)
            except Exception as error:
                failed.append(error)
        if failed:
            raise failed[0]

    def button(self, name: str, press: Callable[[], None]) -> None:
        """Offer a button: start, pause, resume or cancel."""
        self._buttons[name] = press

    @property
    def buttons(self) -> dict[str, Callable[[], None]]:
        """The buttons on offer."""
        return dict(self._buttons)
