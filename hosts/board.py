"""What a print shows of itself, and where a person stops it: between the thread that prints and whoever watches."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vamgpu.hosts.state import State


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A print as it is now.

    slot, slots: how far it is, and of how many; 0 where there is no end.  frame: the picture shown.  position: of the
    stage or web, with ``unit``.  focus: of the lens [1/m], None without one.  fill: of the feed's buffer, 0..1.
    margin: time left when the last picture was ready [ns].  light: whether it is on.  power: of the light.  dark:
    pictures that black stood for.  spent: share of the budget of light.  picture: uint8 [row, column], None at first.
    """

    state: State = State.STANDBY
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
    picture: np.ndarray | None = None


class Board:
    """The newest snapshot, and the buttons. Writing costs the printing thread one reference; readers never block it."""

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
            self._now = replace(self._now, **fields)  # type: ignore[arg-type]

    def on_stop(self, stop: Callable[[str], None]) -> None:
        """What an emergency stop calls, in the order of telling: the light first. One that came before is not lost."""
        self._stops.append(stop)
        if self._stopped is not None:
            stop(self._stopped)

    def stop(self, why: str) -> None:
        """Emergency stop in the caller's thread, which waits for no print to look; all are called, come what may."""
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
