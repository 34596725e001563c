"""Separate processes, their start, and messages between them: JSON, followed by the bytes of arrays.

Messages contain no code, because the address comes from a run's folder, which may be from anywhere.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from enum import Enum
from math import isfinite
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.hosts.records.state import Estimated, ImageCheck, PrintState
from vamgpu.printing.scatter import ScatterReading
from vamgpu.storage.reading import MOST_TOML, parse_json, read_text

ANSWER = 0.3  # longest wait for an answer before a stop becomes a signal, or a process counts as ended [s]
LONGEST = 1 << 28  # most bytes of a message or array
NUMBERS = "biuf"  # kinds of arrays in messages
PIPE = re.compile(r"\\\\\.\\pipe\\[^\\/]+")  # a named pipe of this computer
LIVE = "live.json"  # in a run's folder: address of the process that prints it
KINDS: dict[str, type] = {kind.__name__: kind for kind in (PrintState, ScatterReading, Estimated, ImageCheck)}
"""Enumerations and dataclasses of a snapshot, by name."""


def send(line: Connection, message: dict[str, Any]) -> None:
    """Send a message: plain values, arrays, and the values of a `Snapshot`. Raises `OSError`."""
    arrays: list[np.ndarray] = []
    body = {name: _plain(value, arrays) for name, value in message.items()}
    line.send_bytes(json.dumps({"arrays": len(arrays), "body": body}).encode())
    for array in arrays:
        line.send_bytes(array.tobytes())


def receive(line: Connection) -> dict[str, Any]:
    """The next message. Raises `EOFError`, `OSError`, and `ValueError` for an invalid one."""
    told = parse_json(line.recv_bytes(LONGEST))
    if not isinstance(told, dict) or not isinstance(told.get("body"), dict):
        raise ValueError("a message is an object with a body")
    arrays = iter([line.recv_bytes(LONGEST) for _ in range(int(told["arrays"]))])
    return {name: _made(value, arrays) for name, value in told["body"].items()}


def _plain(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": value.dtype.str, "shape": value.shape}
    if isinstance(value, Enum):
        return {"kind": type(value).__name__, "value": value.value}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        held = {field.name: _plain(getattr(value, field.name), arrays) for field in dataclasses.fields(value)}
        return {"kind": type(value).__name__, "fields": held}
    if isinstance(value, dict):
        return {"dict": {name: _plain(each, arrays) for name, each in value.items()}}
    if isinstance(value, (list, tuple)):
        return [_plain(each, arrays) for each in tuple(value)]
    value = value.item() if isinstance(value, np.generic) else value
    return {"float": str(value)} if isinstance(value, float) and not isfinite(value) else value


def _made(value: Any, arrays: Iterator[bytes]) -> Any:
    if isinstance(value, list):
        return tuple(_made(each, arrays) for each in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        if (dtype := np.dtype(value["array"])).kind not in NUMBERS:
            raise ValueError(f"an array of {dtype}; expected one of numbers")
        return np.frombuffer(next(arrays), dtype).reshape(value["shape"])
    if "float" in value:
        return float(value["float"])
    if "dict" in value:
        return {name: _made(each, arrays) for name, each in value["dict"].items()}
    kind: Any = KINDS[value["kind"]]
    if "value" in value:
        return kind(value["value"])
    return kind(**{name: _made(each, arrays) for name, each in value["fields"].items()})


def spawned(module: str, order: dict[str, Any], errors: Any = None) -> subprocess.Popen[bytes]:
    """Run a module in a process without this terminal's keys. errors: receives its stderr. Raises `OSError`."""
    child = subprocess.Popen(
        [sys.executable, "-m", module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}, start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    )  # fmt: skip
    assert child.stdin is not None
    with suppress(BrokenPipeError), child.stdin:  # a process that has ended is reported by `answered`
        child.stdin.write(json.dumps(order).encode() + b"\n")
    return child


def answered(child: subprocess.Popen[bytes]) -> dict[str, Any] | None:
    """Wait for the address and key at which a child listens; None if it ended instead."""
    assert child.stdout is not None
    with child.stdout:
        line = child.stdout.readline()
    return parse_json(line) if line else None


def ordered() -> tuple[Any, Callable[[str], None]]:
    """In the child: its order, and the function that answers. Other output of the child is ignored."""
    out, nowhere = os.dup(sys.stdout.fileno()), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)

    def answer(text: str) -> None:
        os.write(out, text.encode() + b"\n")
        os.close(out)

    return parse_json(sys.stdin.buffer.readline()), answer


def local(place: str) -> bool:
    """Whether an address is of this computer; other names with two backslashes would contact another one."""
    return not place.startswith("\\\\") or PIPE.fullmatch(place) is not None


def running(folder: Path) -> bool:
    """Whether the process named in a run's folder takes connections."""
    try:
        place = parse_json(read_text(folder / LIVE, MOST_TOML))["address"]
        if place.startswith("\\\\"):
            return local(place) and os.path.exists(place)
        with socket.socket(socket.AF_UNIX) as line:
            line.settimeout(ANSWER)
            line.connect(place)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False
    return True


def address(listener: Listener, key: bytes) -> str:
    """Address and key of this process, as JSON."""
    return json.dumps({"address": listener.address, "key": key.hex(), "pid": os.getpid()})
