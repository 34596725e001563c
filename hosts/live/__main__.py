"""Runs a planning function: ``python -m vamgpu.hosts.live`` with its name in one line of JSON."""

from __future__ import annotations

import os
import secrets
import threading
from contextlib import suppress
from multiprocessing.connection import Listener

from vamgpu.errors import VamError
from vamgpu.hosts.live.worker import PlannerClient, function_of
from vamgpu.hosts.process.messages import address, ordered

STARTING = 10.0  # longest wait for the print that started it [s]


def main() -> None:
    """Plan until the print is over."""
    order, answer = ordered()
    act, key = function_of(order["function"]), secrets.token_bytes(32)
    alone = threading.Timer(STARTING, os._exit, (1,))
    with Listener(authkey=key) as listener:
        alone.start()
        answer(address(listener, key))
        line = listener.accept()
    alone.cancel()
    with line, suppress(EOFError, BrokenPipeError, ConnectionResetError):
        planner = PlannerClient(line)
        try:
            act(planner)
        except Exception as error:  # the operator reads why, not only that the line is closed
            planner.tell({"failed": str(error) if isinstance(error, VamError) else repr(error)})
            raise
        planner.tell({"done": True})


if __name__ == "__main__":
    main()
