"""The planning process: it receives images and shown frames, and proposes frames for coming turns.

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
        task: The print: ``print``, its number; ``jobs``, the folders; ``kind``, a vial or a web; ``turns`` of the vial,
            or segments of the web; ``frames``, slots of one turn or segment; ``shape`` [frame, row, column] of one, and
            ``bits``; ``projectors``; ``period`` of one [s]; ``folder`` of the run; ``settings`` of the order.
    """

    def __init__(self, line: Connection) -> None:
        self._line = line
        self.task: dict[str, Any] = receive(line)["task"]

    def receive(self, timeout: float | None = None) -> dict[str, Any] | None:
        """Wait for the next message.

        Args:
            timeout: Longest wait [s]; None waits until the end of the print.

        Returns:
            A dict: ``image`` uint8 or uint16 [row, column] with its ``angle`` [deg], turns running on, and ``at`` [ns];
                or ``shown``, columns of `vamgpu.hosts.records.record.FRAME_RECORD` by name; or ``answer``, the result
                of a proposal. None after the timeout.

        Raises:
            EOFError: The print is over.
        """
        self.tell({"ready": True})  # a planner that reads is not stuck
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
        """Propose frames from the start of a turn of a vial, or of a segment of a web.

        Args:
            levels: Gray levels for the mirrors, one array [frame, row, column] for each projector; for a web, the poses
                of one segment or of several. Later frames stay as they were.
            turn: The first turn, or segment, that shows them, counted from 0.
            stop: The turn, or segment, before which the light ends; None shows all.
        """
        pieces = [list(_pieces(each)) for each in levels]
        self.tell({"version": {"print": self.task["print"], "levels": pieces, "turn": turn, "stop": stop}})

    def estimate(
        self,
        parameters: Sequence[tuple[str, float, float] | tuple[str, float, float, float, float]],
        maps: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        """Send estimates for display.

        Args:
            parameters: Name with its unit, value and standard deviation of each, and the expected lowest and highest
                value if known, for a bar on the page.
            maps: Images by name, uint8 [row, column, color]; None keeps the earlier ones.
        """
        told: dict[str, Any] = {"parameters": [list(each) for each in parameters]}
        self.tell(told if maps is None else told | {"maps": dict(maps)})

    def checked(self, checks: Sequence[tuple[str, int, float, float]], doubt: str = "") -> None:
        """Send checks of a turn's images for display.

        Args:
            checks: Name, turns shown so far, value and limit of each.
            doubt: Reason why the images are no longer used, for the record, once; empty if they are.
        """
        self.tell({"checks": [list(each) for each in checks], "doubt": doubt})

    def tell(self, message: dict[str, Any]) -> None:
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
