"""The states of a print, in the words that users of printers know, and the ways from one to another."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from vamgpu.errors import VamError


class WrongState(VamError, RuntimeError):
    """A print was asked for something that its state does not allow."""


class State(StrEnum):
    """Where a print is."""

    STANDBY = "standby"
    PRINTING = "printing"
    PAUSED = "paused"
    COMPLETE = "complete"
    CANCELLED = "cancelled"
    ERROR = "error"

    @property
    def ended(self) -> bool:
        """Whether nothing follows but another print."""
        return self in (State.COMPLETE, State.CANCELLED, State.ERROR)


_ENDS = frozenset((State.CANCELLED, State.ERROR))
NEXT: dict[State, frozenset[State]] = {
    State.STANDBY: _ENDS | {State.PRINTING},
    State.PRINTING: _ENDS | {State.PAUSED, State.COMPLETE},
    State.PAUSED: _ENDS | {State.PRINTING},
    State.COMPLETE: frozenset(),
    State.CANCELLED: frozenset(),
    State.ERROR: frozenset(),
}
"""What may follow each state. An error may follow everything that has not ended; nothing follows an end."""


@dataclass(frozen=True)
class Change:
    """A step from one state to another, and why."""

    before: State
    after: State
    message: str


class States:
    """The state of one print. Any thread may ask for a change; listeners hear of each, in order, in that thread."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._state = State.STANDBY
        self._message = ""
        self._listeners: list[Callable[[Change], None]] = []

    @property
    def state(self) -> State:
        """Where the print is now."""
        return self._state

    @property
    def message(self) -> str:
        """Why it is there."""
        return self._message

    def listen(self, listener: Callable[[Change], None]) -> None:
        """Hear of every change from now on."""
        with self._lock:
            self._listeners.append(listener)

    def to(self, state: State, message: str = "") -> bool:
        """Go to ``state``; False where the print is there already. Raises `WrongState` where no way leads there."""
        with self._lock:
            before = self._state
            if state is before:
                return False
            if state not in NEXT[before]:
                ways = ", ".join(sorted(each.value for each in NEXT[before])) or "nothing; begin another print"
                raise WrongState(f"the print is {before.value} and cannot become {state.value}; from here: {ways}")
            self._state, self._message = state, message
            for listener in tuple(self._listeners):
                listener(Change(before, state, message))
            return True

    def end(self, state: State, message: str = "") -> bool:
        """Go to an end unless one was reached before: the first end, and its reason, stay."""
        with self._lock:
            return not self._state.ended and self.to(state, message)
