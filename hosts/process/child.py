"""A process of its own: a line of JSON orders its work, and it answers with where it listens."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Listener
from typing import Any

from vamgpu.storage.reading import parse_json


def spawned(module: str, order: dict[str, Any], errors: Any = None) -> subprocess.Popen[bytes]:
    """Run a module in a process that no key of this terminal reaches. errors: takes its stderr. Raises `OSError`."""
    child = subprocess.Popen(
        [sys.executable, "-m", module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}, start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    )  # fmt: skip
    assert child.stdin is not None
    with suppress(BrokenPipeError), child.stdin:  # one that has ended already says nothing, see `answered`
        child.stdin.write(json.dumps(order).encode() + b"\n")
    return child


def answered(child: subprocess.Popen[bytes]) -> dict[str, Any] | None:
    """Wait for the address and key at which a child listens; None where it ended instead."""
    assert child.stdout is not None
    with child.stdout:
        line = child.stdout.readline()
    return parse_json(line) if line else None


def ordered() -> tuple[Any, Callable[[str], None]]:
    """In the child: its order, and the function that answers it. Nothing else that the child prints is read."""
    out, nowhere = os.dup(sys.stdout.fileno()), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)

    def answer(text: str) -> None:
        os.write(out, text.encode() + b"\n")
        os.close(out)

    return parse_json(sys.stdin.buffer.readline()), answer


def address(listener: Listener, key: bytes) -> str:
    """Where and how this process can be reached, as JSON."""
    return json.dumps({"address": listener.address, "key": key.hex(), "pid": os.getpid()})
