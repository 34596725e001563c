"""Progress of a run as lines of JSON in a hidden file beside the folder that it writes; any process may read it."""

from __future__ import annotations

import json
import os
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import Cancelled
from vamgpu.methods.plan import Step
from vamgpu.storage.atomic import locked
from vamgpu.storage.reading import open_file, parse_json

PERIOD = 0.25  # shortest interval between two lines on the share that is done [s]
SLICES, COST = 0.5, 20.0
"""Shortest interval between slices: [s], and relative to the time of one, so that they take at most 5 % of a run."""
TRIES = 20  # attempts to lock the file
MOST_READ = 1 << 22  # bytes that are read at a time
STOPPED = 130  # exit status of a run that its user stopped

Slice = Callable[[], "tuple[np.ndarray, np.ndarray] | None"]


def events_path(place: Path) -> Path:
    """The file with the progress of the run that writes ``place``."""
    return place.with_name(f".{place.name}.events.jsonl")


def slice_path(place: Path) -> Path:
    """The file with the newest slice of that run: float16 [dose and target, y, z] at x = 0."""
    return place.with_name(f".{place.name}.slice.npy")


class RunEvents:
    """Writes the progress of one run. A full or read-only disk never ends the run."""

    def __init__(self, place: Path, slices: bool = False) -> None:
        self._place, self._due, self._last, self._count = place, 0.0, -PERIOD, 0
        self._stage, self._line, self._share, self._lock = "", dict[str, Any](), 0.0, threading.RLock()
        self.look: Callable[[Slice], None] | None = self._look if slices else None
        with suppress(OSError):
            slice_path(place).unlink(missing_ok=True)
        self._file: int | None = None
        self._cut = b""
        with suppress(OSError):
            self._file = os.open(events_path(place), os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
            for _ in range(TRIES):  # a reader that tests the lock holds it for a moment
                if locked(self._file):
                    os.ftruncate(self._file, 0)
                    return
                time.sleep(0.05)
        self.close()  # another run writes the same place, or nobody can tell whether one does

    def say(self, event: str, **facts: Any) -> None:
        """Add a whole line; several threads may call it."""
        line = json.dumps({"event": event, "wall": time.time(), **facts}).encode() + b"\n"
        with self._lock, suppress(OSError):
            if self._file is not None:
                cut = os.write(self._file, self._cut + line) < len(self._cut + line)
                self._cut = b"\n" if cut else b""  # the disk is full: end the incomplete line

    def share(self, stage: str, said: str, share: float) -> None:
        """Report a stage, and the share of it that is done."""
        now = time.monotonic()
        with self._lock:
            if stage != self._stage:
                self.flush()
                self._stage = stage
                self.say("stage", stage=stage, said=said)
            elif now - self._last < PERIOD and share < 1.0:
                self._share = share
                return
            else:
                self.say("share", share=share, **self._line)
            self._last, self._line = now, {}

    def flush(self) -> None:
        """Add the last step, if no line has it."""
        if self._line:
            self.say("share", share=self._share, **self._line)
            self._line = {}

    def step(self, step: Step) -> None:
        """Keep a step for the next line."""
        self._line = {name: value for name, value in asdict(step).items() if np.isfinite(value)}

    def verdict(self, prints: bool, sentence: str) -> None:
        """Report the verdict on a print."""
        self.say("verdict", prints=prints, sentence=sentence)

    def _look(self, made: Slice) -> None:
        """Store a slice if one is due."""
        began = time.monotonic()
        if began < self._due or (found := made()) is None:
            return
        place = slice_path(self._place)
        with suppress(OSError):
            draft = place.with_name(f"{place.name}.{os.getpid()}")
            with draft.open("wb") as file:
                np.save(file, np.stack(found).astype("<f2"), allow_pickle=False)
            os.replace(draft, place)
            self._count += 1
            self.say("slice", count=self._count)
        self._due = time.monotonic() + max(SLICES, COST * (time.monotonic() - began))

    def close(self, drop: bool = False) -> None:
        """Release the file, which shows readers that the run is over; ``drop``: and remove it if no stage began."""
        if self._file is not None:
            if drop and not self._stage:
                with suppress(OSError):
                    events_path(self._place).unlink()
            os.close(self._file)
            self._file = None


@contextmanager
def recorded(place: Path, command: str, slices: bool = False, job: dict[str, Any] | None = None) -> Iterator[RunEvents]:
    """Record a run that writes ``place``, with the keys of its job, its warnings and its end."""
    events, shown = RunEvents(place, slices), warnings.showwarning

    def warn(message: Warning | str, *rest: Any, **named: Any) -> None:
        events.say("warning", text=str(message))
        shown(message, *rest, **named)

    warnings.showwarning = warn
    status, message = 0, ""
    events.say("began", command=command, pid=os.getpid(), job=job)
    try:
        yield events
    except BaseException as error:
        status = STOPPED if isinstance(error, (Cancelled, KeyboardInterrupt)) else 1
        message = str(error) or type(error).__name__
        raise
    finally:
        warnings.showwarning = shown
        events.flush()
        events.say("ended", status=status, message=message)
        events.close(drop=status != 0)


@dataclass
class RunProgress:
    """The progress of a run according to its file; `read` continues where it stopped."""

    place: Path
    pid: int = 0
    began: float = 0.0
    wall: float = 0.0
    stage: str = ""
    said: str = ""
    share: float = 0.0
    stages: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    steps: list[dict[str, Any]] = field(default_factory=list)
    slices: int = 0
    status: int | None = None
    message: str = ""
    verdict: dict[str, Any] | None = None
    job: dict[str, Any] | None = None
    _since: float = 0.0
    _at: tuple[int, int] = (0, 0)  # inode and offset of what was read

    @property
    def running(self) -> bool:
        """Whether a process holds the file."""
        try:
            file = os.open(events_path(self.place), os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return False
        try:
            return not locked(file)
        finally:
            os.close(file)

    @property
    def left(self) -> float | None:
        """Time left in the stage, if it is known [s]."""
        spent = self.wall - self._since
        return spent * (1.0 - self.share) / self.share if 0.0 < self.share < 1.0 and spent > 0.0 else None

    def read(self) -> bool:
        """Read what was added; returns whether anything was. A new run in the same place starts anew."""
        try:
            with open_file(events_path(self.place)) as file:
                stat = os.fstat(file.fileno())
                if stat.st_ino != self._at[0] or stat.st_size < self._at[1] or self._restarted(file):
                    self.__init__(self.place)  # type: ignore[misc]
                    self._at = (stat.st_ino, 0)
                file.seek(self._at[1])
                data = file.read(MOST_READ)
        except OSError:
            return False
        whole = data[: data.rfind(b"\n") + 1]
        self._at = (self._at[0], self._at[1] + len(whole))
        for line in whole.splitlines():
            with suppress(ValueError, KeyError, TypeError, AttributeError):
                self._add(parse_json(line))
        return bool(whole)

    def _restarted(self, file: Any) -> bool:
        """Whether the file was emptied and begun again since it was read."""
        first = file.readline(MOST_READ)
        with suppress(ValueError, KeyError, TypeError):
            return self.began > 0.0 and float(parse_json(first)["wall"]) != self.began
        return False

    def _add(self, line: dict[str, Any]) -> None:
        event, wall = line["event"], float(line["wall"])
        if event == "began":
            self.pid, self.began, self.job = int(line["pid"]), wall, line.get("job")
        elif event in ("stage", "ended") and self.stage:
            self.stages.append({"stage": self.stage, "said": self.said, "seconds": wall - self._since})
        if event == "stage":
            self.stage, self.said, self.share, self._since = str(line["stage"]), str(line["said"]), 0.0, wall
        elif event == "share":
            self.share = float(line["share"])
            self.steps += [{name: line.get(name) for name in STEP}] if "iteration" in line else []
        elif event in ("note", "warning"):
            (self.notes if event == "note" else self.warnings).append(str(line["text"]))
        elif event == "slice":
            self.slices = int(line["count"])
        elif event == "verdict":
            self.verdict = {"prints": bool(line["prints"]), "sentence": str(line["sentence"])}
        elif event == "ended":
            self.status, self.message, self.stage = int(line["status"]), str(line["message"]), ""
        self.wall = wall


STEP = ("iteration", "evaluations", "loss", "window")  # numbers of a `Step`
