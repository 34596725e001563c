"""The folder of a run: its request, its events, and every shown frame, written as they happen.

Each frame is one record with a check sum, written before the next frame is shown; a killed host therefore loses none.
"""

from __future__ import annotations

import ctypes
import errno
import json
import os
import struct
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Self

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.records.account import account
from vamgpu.hosts.records.state import PrintState, StateChange
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.storage.atomic import explained, explaining
from vamgpu.storage.reading import MOST_RECORD, open_file, parse_json, read_bytes, read_text

FULL = (errno.ENOSPC, errno.EDQUOT)  # errors of a full disk, or of a full quota
RESERVE = ".reserve"  # bytes reserved for the timing on a full disk
KEEP_SIZE = 1  # of the system's fallocate: the file takes space beyond its end
LONGEST = 2000  # characters of a state's message that are kept
EVENTS = 1 << 16, 400  # space for the events of a run [bytes], and more for each second
MAGIC = b"VAMSHOWN\x02\x00\x00\x00"
_TIMES = ("slot", "frame", "position", "start", "on_time", "late")
FRAME_RECORD = np.dtype(
    [*((name, "<i8") for name in _TIMES), ("engine", "<u2"), ("dark", "<u2"), ("version", "<u4"), ("check", "<u4")]
)
"""A record: slot and frame numbers, position as a pose counted over turns, start, on_time, lateness [ns] (negative:
early), projector, 1 if black was shown instead, and the version of the frame."""


@dataclass(frozen=True)
class FrameRecord:
    """A shown frame, or the black in its place."""

    slot: int
    frame: int
    position: int
    start: int
    on_time: int
    late: int = 0
    engine: int = 0
    dark: bool = False
    version: int = 0

    @classmethod
    def of(cls, schedule: Schedule, slot: int, engine: int, version: int) -> Self:
        """The planned frame of a slot."""
        frame, pose, light, on = (int(getattr(schedule, name)[slot]) for name in ("frame", "pose", "light", "on"))
        return cls(slot, frame, pose, light, on, engine=engine, version=version)

    def packed(self) -> bytes:
        """The record, with its check sum."""
        numbers = (self.slot, self.frame, self.position, self.start, self.on_time, self.late)
        body = struct.pack("<6q2HI", *numbers, self.engine, int(self.dark), self.version)
        return body + struct.pack("<I", zlib.crc32(body))


class RunFolder:
    """Writes the folder of a run, from any thread; a full disk raises `StorageError`, and the print must stop."""

    def __init__(self, path: Path, resume: bool = False) -> None:
        self.path = path
        self._lock = threading.RLock()
        self._write: Callable[[int, bytes], int] = os.write
        self.failed: bool = False  # whether a record could not be written, and was not written since
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
        with explaining("write in", path):
            self._events = os.open(path / "events.jsonl", flags, 0o644)
            self._shown = os.open(path / "shown.bin", flags, 0o644)
        if resume:
            self._cut()
        else:
            self._put(self._shown, MAGIC, "shown.bin")

    @classmethod
    def begin(cls, path: str | Path, asked: Mapping[str, Any], rig: str) -> Self:
        """A new folder. asked: request, as JSON values.  rig: text of its file. Raises `BadInput`, `StorageError`."""
        try:
            place, text, told = Path(path), rig.encode(), json.dumps(dict(asked), indent=2) + "\n"
        except (TypeError, ValueError, AttributeError, RecursionError) as error:
            raise BadInput(
                f"the folder of a run cannot store the request: {error}; expected a path, values for JSON, and the "
                "text of the rig's file"
            ) from error
        try:
            place.mkdir(parents=True)
            (place / RESERVE).write_bytes(b"\xff" * 16384)
            (place / "rig.toml").write_bytes(text)
            (place / "run.json").write_text(told, encoding="utf-8")
        except FileExistsError as error:
            raise StorageError(f"{str(path)!r} exists; expected a new folder for the run: choose another") from error
        except OSError as error:
            raise explained("write", place, error) from error
        folder = cls(place)
        try:
            folder.state(StateChange(PrintState.STANDBY, PrintState.STANDBY, ""))
            folder.take_space(asked)
        except BaseException:
            with suppress(StorageError):
                folder.close()
            raise
        return folder

    def take_space(self, asked: Mapping[str, Any]) -> None:
        """Take the space that the run needs, before the light. Raises `StorageError` on a full disk."""
        views = asked.get("views") or {}
        slots = int(asked.get("slots", 0)) + 2 * int(views.get("frames", 0))  # with added turns
        events = EVENTS[0] + round(EVENTS[1] * float(asked.get("seconds", 0.0)))
        sizes = ((self._shown, slots * int(views.get("engines", 1)) * FRAME_RECORD.itemsize), (self._events, events))
        for file, size in sizes:
            with explaining(f"take {size} bytes for the record of the run in", self.path):
                take(file, size)

    @classmethod
    def again(cls, path: str | Path) -> Self:
        """The folder of a resumed run; an incomplete last record is cut off."""
        asked = read_run(path).asked
        folder = cls(Path(path), resume=True)
        folder.take_space(asked)
        return folder

    def event(self, kind: str, at: int, **facts: Any) -> None:
        """Write an event. at: the rig's clock [ns]."""
        line = {"at": int(at), "wall": round(time.time(), 3), "event": kind} | facts
        self._put(self._events, (json.dumps(line, default=str) + "\n").encode(), "events.jsonl")

    def shown(self, shown: FrameRecord) -> None:
        self._put(self._shown, shown.packed(), "shown.bin")

    def state(self, change: StateChange) -> None:
        """Write the state atomically."""
        told: dict[str, Any] = {"state": change.after.value, "message": change.message[:LONGEST]}
        told |= {"wall": round(time.time(), 3)} | ({"unwritten": True} if self.failed else {})
        text, place, draft = json.dumps(told) + "\n", self.path / "state.json", self.path / ".state.json"
        with explaining("write", place):
            try:
                draft.write_text(text, encoding="utf-8")
                os.replace(draft, place)
            except OSError as error:
                if error.errno not in FULL:
                    raise
                with suppress(OSError):
                    draft.unlink(missing_ok=True)
                with place.open("r+b", buffering=0) as file:  # its block is taken already
                    file.write(text.encode().ljust(place.stat().st_size))

    def close(self) -> None:
        """Write the timing and close the files; may be called more than once."""
        with self._lock:
            if self._events < 0:
                return
            for file in (self._events, self._shown):
                os.ftruncate(file, os.fstat(file).st_size)  # gives back the space that was not used
                os.close(file)
            self._events = self._shown = -1
        with explaining("write", self.path / "timing.json"):
            run = read_run(self.path)
            light = {} if (found := account(run)) is None else {"light": found.facts()}
            text = json.dumps(timing(run.shown) | {"state": run.state.value} | light, indent=2)
            (self.path / RESERVE).unlink(missing_ok=True)
            (self.path / "timing.json").write_text(text + "\n", encoding="utf-8")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            self.close()
        except StorageError:
            if error is None:
                raise  # else the first error is raised

    def _put(self, file: int, data: bytes, name: str) -> None:
        with self._lock:
            try:
                written = self._write(file, data)
            except OSError as error:
                self.failed = True
                raise explained("write", self.path / name, error) from error
            if written != len(data):
                self.failed = True
                os.ftruncate(file, os.fstat(file).st_size - written)
                raise StorageError(f"{str(self.path / name)!r} took {written} of {len(data)} bytes: the disk is full")

    def _cut(self) -> None:
        """Cut off an incomplete record."""
        whole = len(MAGIC) + len(read_run(self.path).shown) * FRAME_RECORD.itemsize
        os.truncate(self.path / "shown.bin", whole)
        lines = read_bytes(self.path / "events.jsonl", MOST_RECORD)
        os.truncate(self.path / "events.jsonl", lines.rfind(b"\n") + 1)


@dataclass(frozen=True, eq=False)
class RunRecord:
    """A run, read from its folder."""

    path: Path
    asked: dict[str, Any]
    state: PrintState
    message: str
    shown: np.ndarray  # `FRAME_RECORD`, one per frame, in order
    events: tuple[dict[str, Any], ...]
    torn: int  # bytes of an incomplete last record
    unwritten: bool = False  # whether the last records could not be written

    @property
    def doubt(self) -> tuple[tuple[int, int], ...]:
        """First and stop of slots that were lit for an unknown time."""
        return tuple((each["first"], each["stop"]) for each in self.events if each["event"] == "unseen")


def take(file: int, size: int) -> None:
    """Take space for the next bytes of an open file, where the system can. Raises `OSError` if there is too little."""
    if sys.platform != "linux" or size <= 0:
        return
    allocate = getattr(ctypes.CDLL(None, use_errno=True), "fallocate64", None)
    place = ctypes.c_int64(os.fstat(file).st_size), ctypes.c_int64(size)
    if allocate is not None and allocate(file, KEEP_SIZE, *place) and (number := ctypes.get_errno()) in FULL:
        raise OSError(number, os.strerror(number))


def read_run(path: str | Path) -> RunRecord:
    """Read the folder of a run, also of a killed one. Raises `StorageError` for other folders."""
    place = Path(path)
    try:
        asked = dict(parse_json(read_text(place / "run.json")))
        told = parse_json(read_text(place / "state.json"))
        data = read_bytes(place / "shown.bin", MOST_RECORD)
        with open_file(place / "events.jsonl") as lines:
            events = _told(lines)
        state, message, unwritten = PrintState(told["state"]), str(told["message"]), bool(told.get("unwritten"))
    except FileNotFoundError as error:
        if not place.is_dir():
            raise explained("read", place, error) from error
        lacks = Path(str(error.filename)).name
        raise StorageError(f"{str(path)!r} is not the folder of a run: it has no {lacks}; check the path") from error
    except OSError as error:
        raise explained("read", place, error) from error
    except (ValueError, KeyError, TypeError) as error:
        raise StorageError(f"{str(path)!r} is not the folder of a run: {error}; check the path") from error
    if not data.startswith(MAGIC):
        raise StorageError(
            f"{str(place / 'shown.bin')!r} is not a record of frames, or from version 0.2 or earlier; check the path, "
            "or read it with the version that wrote it"
        )
    body, size = memoryview(data)[len(MAGIC) :], FRAME_RECORD.itemsize
    count = next((n for n in range(len(body) // size) if not _whole(body, n, size)), len(body) // size)
    shown = np.frombuffer(body, FRAME_RECORD, count)
    torn = len(body) - count * size
    return RunRecord(place, asked, state, message, shown, events, torn, unwritten)


def _told(lines: Iterable[bytes]) -> tuple[dict[str, Any], ...]:
    """The events of lines; of successive polls only the last."""
    found: list[dict[str, Any]] = []
    for line in lines:
        if not line.endswith(b"\n") or (event := _event(line)) is None:
            continue
        if found and found[-1].get("event") == event.get("event") == "poll":
            found.pop()
        found.append(event)
    return tuple(found)


def _event(line: bytes) -> dict[str, Any] | None:
    """An event; None for an incomplete line."""
    try:
        event = parse_json(line)
    except ValueError:
        return None
    return event if isinstance(event, dict) else None


def _whole(body: memoryview, number: int, size: int) -> bool:
    record = body[number * size : (number + 1) * size]
    return zlib.crc32(record[:-4]) == int.from_bytes(record[-4:], "little")


def digest(job: Path) -> str:
    """The check sum of a job folder's record of its frames, or of the names and sizes of slices."""
    manifest = job / "manifest.json"
    if manifest.is_file():
        return sha256(read_bytes(manifest)).hexdigest()
    files = sorted((file.name, file.stat().st_size) for file in job.iterdir()) if job.is_dir() else []
    return sha256(repr(files or job.name).encode()).hexdigest()


def timing(shown: np.ndarray) -> dict[str, Any]:
    """Lateness of the frames: p50, p99 and greatest [ns], and a histogram with doubling bins from 1 µs."""
    late = shown["late"].astype(np.float64)
    edges = [0, *(1000 * 2**power for power in range(16))]
    p50, p99, most = np.percentile(late, [50, 99, 100]) if len(late) else (0.0, 0.0, 0.0)
    counts = np.histogram(np.clip(late, 0, edges[-1]), edges)[0]
    return {
        "frames": len(shown),
        "dark": int(np.count_nonzero(shown["dark"])),
        "late_ns": {"p50": float(p50), "p99": float(p99), "max": float(most)},
        "histogram": {"edges_ns": edges, "counts": counts.tolist()},
    }
