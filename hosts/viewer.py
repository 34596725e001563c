"""The picture that is shown, for those who watch: drawn in a thread of its own, which no print waits for."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Self

import numpy as np

from vamgpu.hosts.board import Board

log = logging.getLogger(__name__)
PERIOD = 0.2
"""Between two pictures [s]."""
LEAVE = 1.0
"""How long the thread may take to end [s]."""


class Viewer:
    """Puts the picture of the board's frame on the board; a context. picture: of a number, uint8 [row, column].

    A disk that hangs, or a picture that cannot be drawn, leaves the board with the one before.
    """

    def __init__(self, board: Board, picture: Callable[[int], np.ndarray]) -> None:
        self._board, self._picture = board, picture
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
            frame = self._board.now.frame
            if frame >= 0 and frame != drawn:
                drawn = frame
                try:
                    self._board.show(picture=self._picture(frame))
                except Exception as error:
                    log.warning("picture %d cannot be drawn: %s", frame, error)
