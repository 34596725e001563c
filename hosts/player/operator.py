"""A print with an operator, who pauses, resumes and cancels it, and decides whether a held print continues."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import nullcontext
from typing import Self

import numpy as np

from vamgpu.errors import VamError
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.state import Board, PrintState, WrongState
from vamgpu.hosts.schedules.timing import SECOND

log: logging.Logger = logging.getLogger(__name__)
PERIOD = 0.2  # between two previews [s]
LEAVE = 1.0  # longest time for the thread to end [s]


class Viewer:
    """Draws shown frames as the board's previews; a context manager. frame: (number, projector) → [row, column]."""

    def __init__(self, board: Board, frame: Callable[[int, int], np.ndarray], engines: int = 1) -> None:
        self._board, self._frame, self._engines = board, frame, engines
        self._leave = threading.Event()
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._leave.set()
        self._thread.join(LEAVE)

    def _run(self) -> None:
        drawn = -1
        while not self._leave.wait(PERIOD):
            number = self._board.now.frame
            if number >= 0 and number != drawn:
                drawn = number
                try:
                    first, *others = (self._frame(number, engine) for engine in range(self._engines))
                    self._board.show(preview=first, others=tuple(others))
                except Exception as error:
                    log.warning("frame %d cannot be drawn: %s", number, error)


POLL = 50_000_000  # between two polls of the buttons in a pause [ns]
AGAIN = SECOND  # time between two unattended tries to continue [ns]


def attended(
    job: Print, first: int | None = None, go_on: Callable[[], bool] | None = None, unattended: int = 0
) -> PrintState:
    """Print to the end; a held print continues by go_on or ``unattended`` tries. Raises what ended or holds it."""
    while True:
        error = None
        try:
            state = job.run(first)
        except VamError as held:
            state, error = job.states.state, held
            if state is not PrintState.HELD:
                raise
        if not state.waits:
            return state
        first = None
        if state is PrintState.HELD and job.holds <= unattended:
            job.player.clock.sleep_until(job.player.clock.now() + AGAIN)
        elif go_on is None or not go_on():
            if error is not None and job.states.state is PrintState.HELD:
                raise error
            return job.states.state


def print_with_operator(
    job: Print, board: Board, first: int | None = None, unattended: int = 0, go_on: Callable[[], bool] | None = None
) -> PrintState:
    """Print to the end with the buttons of a page, see `attended`; a pause that is too long ends the print."""
    going = threading.Event()

    def pause() -> None:
        if job.states.state is not PrintState.PRINTING:
            raise WrongState(f"the print is {job.states.state.value}; only a running print can pause")
        going.clear()  # a second press, while the print prepares to continue
        job.pause()

    def resume() -> None:
        if not job.states.state.waits:
            raise WrongState(f"the print is {job.states.state.value}; only a paused or held print can continue")
        going.set()

    def goes_on() -> bool:
        held = job.states.state is PrintState.HELD
        resumed = go_on() if held and go_on is not None else _resumed(job, going)
        going.clear()
        return resumed

    for name, press in (("pause", pause), ("resume", resume), ("cancel", lambda: job.stop("cancelled at the page"))):
        board.button(name, press)
    drawn = board.draws_previews and go_on is None
    watching = Viewer(board, job.player.frame, job.player.schedule.engines) if drawn else nullcontext()
    with watching:
        return attended(job, first, goes_on, unattended)


def _resumed(job: Print, going: threading.Event) -> bool:
    """Wait for the button; False if the print was cancelled, or waited for too long."""
    clock = job.player.clock
    while job.asked is not PrintState.CANCELLED:
        if going.is_set():
            return True
        if clock.now() - (job.dark_since or 0) > job.limits.resume:
            held = job.states.state is PrintState.HELD
            end = PrintState.ERROR if held else PrintState.CANCELLED
            job.states.end(end, f"held for too long: {job.states.message}" if held else "paused for too long")
            return False
        job.sense()
        clock.sleep_until(clock.now() + POLL)
    job.states.end(PrintState.CANCELLED, f"cancelled while {job.states.state.value}")
    return False
