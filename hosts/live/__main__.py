"""Runs a planning function: ``python -m vamgpu.hosts.live`` with one line of JSON, address, key and function."""

from __future__ import annotations

import sys
from contextlib import suppress
from multiprocessing.connection import Client
from typing import Any

from vamgpu.hosts.live.worker import Desk, function_of
from vamgpu.storage.reading import parse_json


def main() -> None:
    """Plan until the print is over."""
    told = parse_json(sys.stdin.buffer.readline())
    act = function_of(told["function"])
    line: Any = Client(told["address"], authkey=bytes.fromhex(told["key"]))
    with line, suppress(EOFError, BrokenPipeError, ConnectionResetError):
        desk = Desk(line)
        act(desk)
        desk.tell({"done": True})


if __name__ == "__main__":
    main()
