"""The planning process: it receives what was seen and shown, and proposes frames for the turns to come.

Its function is named ``package.module:function``, is called with a `PlannerClient`, and returns when it is done.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.process.messages import receive, send

PIECE = 2**26  # bytes of an array in a message


class PlannerClient:
    """The planning function's connection to the print.

    Attributes:
        task: What is printed: ``print``, the number of this print; ``jobs``, the folders; ``kind``, a vial or a web;
            ``turns``, those of the vial, or the segments of the web; ``frames``, slots of one; ``shape`` [frame, row,
            column] of one, and ``bits``; ``projectors``; ``period`` of one [s]; ``folder`` of the run;
            ``settings`` of the order.
    """

    task: dict[str, Any]

    def __init__(self, line: Connection) -> None:
        self._line = line
        self.task = receive(line)["task"]

    def receive(self, timeout: float | None = None) -> dict[str, Any] | None:
        """Wait for what comes next.

        Args:
            timeout: How long to wait [s]; None waits for as long as the print lasts.

        Returns:
            A dict: ``image`` uint8 or uint16 [row, column] with its ``angle`` [deg], turns running on, and ``at`` [ns];
            or ``shown``, columns of `vamgpu.hosts.records.record.FRAME_RECORD` by name; or ``answer``, what became of a
            proposal. None after the timeout.

        Raises:
            EOFError: The print is over.
        """
        self.tell({"ready": True})  # who asks for more is not stuck
        return receive(self._line) if self._line.poll(timeout) else None

    def __iter__(self) -> Iterator[dict[str, Any]]:
        while True:
            try:
                told = self.receive()
            except (EOFError, OSError):
                return
            if told is not None:
                yield told

    def propose(self, levels: Sequence[np.ndarray], turn: int, stop: int | None = None) -> None:
        """Propose frames from the beginning of a turn of a vial, or of a segment of a web, on.

        Args:
            levels: Gray levels that the mirrors show, one array [frame, row, column] for each projector; of a web, the
                poses of one segment or of several. What is behind them stays as it was.
            turn: The first turn, or segment, that shows them, counted from 0.
            stop: That before which the light ends; None shows all.
        """
        pieces = [list(_pieces(each)) for each in levels]
        self.tell({"version": {"print": self.task["print"], "levels": pieces, "turn": turn, "stop": stop}})

    def estimate(
        self,
        parameters: Sequence[tuple[str, float, float] | tuple[str, float, float, float, float]],
        maps: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        """Tell what is believed, for people.

        Args:
            parameters: Name with its unit, value and standard deviation of each, and the lowest and the highest value
                that was to be expected where they are known: the page draws a bar.
            maps: Images by name, uint8 [row, column, color]; those told before stay without it.
        """
        told: dict[str, Any] = {"parameters": [list(each) for each in parameters]}
        self.tell(told if maps is None else told | {"maps": dict(maps)})

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message as it is."""
        send(self._line, message)


def _pieces(levels: np.ndarray) -> Iterator[np.ndarray]:
    step = max(1, PIECE // max(levels[:1].nbytes, 1))
    return (levels[first : first + step] for first in range(0, len(levels), step))


def function_of(name: str) -> Callable[[PlannerClient], object]:
    """The planning function of a name. Raises `BadInput`."""
    module, _, attribute = name.partition(":")
    try:
        return getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise BadInput(f"no planning function {name!r}: {error}; expected package.module:function") from error
