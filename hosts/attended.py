"""A print that a person attends: buttons to pause it, go on and cancel, on the board of its live page."""

from __future__ import annotations

import threading

from vamgpu.hosts.board import Board
from vamgpu.hosts.run import Print
from vamgpu.hosts.state import State, WrongState
from vamgpu.hosts.viewer import Viewer

LOOK = 50_000_000
"""Between two looks at the buttons while it rests [ns]."""


def attended(job: Print, board: Board, first: int | None = None) -> State:
    """Print to the end, through pauses; one that rests for longer than resin remembers is cancelled."""
    going = threading.Event()

    def pause() -> None:
        if job.states.state is not State.PRINTING:
            raise WrongState(f"the print is {job.states.state.value}; only one that prints can pause")
        going.clear()  # of one that pressed twice, while the print got ready to go on
        job.pause()

    def resume() -> None:
        if job.states.state is not State.PAUSED:
            raise WrongState(f"the print is {job.states.state.value}; only one that is paused can go on")
        going.set()

    for name, press in (("pause", pause), ("resume", resume), ("cancel", lambda: job.stop("cancelled at the page"))):
        board.button(name, press)
    with Viewer(board, job.player.picture):
        state = job.run(first)
        while state is State.PAUSED and _rested(job, going):
            going.clear()
            state = job.run()
    return job.states.state


def _rested(job: Print, going: threading.Event) -> bool:
    """Wait for the button; False where the print was cancelled, or rested for too long."""
    clock = job.player.clock
    while job.asked is not State.CANCELLED:
        if going.is_set():
            return True
        if clock.now() - (job.dark_since or 0) > job.limits.resume:
            job.states.end(State.CANCELLED, "rested for too long")
            return False
        clock.sleep_until(clock.now() + LOOK)
    job.states.end(State.CANCELLED, "cancelled at rest")
    return False
