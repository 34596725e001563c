"""Tasks: command lines in processes of their own, which outlive the page and its server."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np

from vamgpu.errors import VamError
from vamgpu.jobs.progress import STEP, STOPPED, RunProgress, slice_path
from vamgpu.storage.atomic import locked, replacing
from vamgpu.storage.numpy_files import map_npy
from vamgpu.storage.reading import parse_json, read_text
from vamgpu.studio.commands import Command, newest
from vamgpu.studio.workspace import RESULT, Refused, Workspace

POINTS = 500  # largest number of points of a history
PATIENCE = 10.0  # time after which a second request to cancel kills a task [s]
TAIL = 65536  # bytes of a log that are shown
MOST = 1000  # largest number of tasks in the list
ENDED = ("done", "failed", "cancelled")


@dataclass(eq=False)
class Task:
    """A task of the queue, as its file has it."""

    id: str
    request: dict[str, Any]
    state: str = "queued"
    added: float = 0.0
    began: float | None = None
    ended: float | None = None
    status: int | None = None
    message: str = ""
    pid: int = 0
    facts: dict[str, Any] = field(default_factory=dict)  # job, result, rig, run, made, lane and place of its progress
    shown: dict[str, Any] | None = None  # the last progress
    asked: float = 0.0  # when it was asked to end


class Tasks:
    """The queue of a workspace. told: called with the name and the data of an event."""

    def __init__(self, workspace: Workspace, told: Callable[[str, dict[str, Any]], None]) -> None:
        self._workspace, self._told, self._folder = workspace, told, workspace.own / "tasks"
        self._lock, self._numbers = RLock(), count(1)
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._progress: dict[str, RunProgress] = {}
        self._known: dict[str, Task] = {}
        for file in sorted(self._folder.glob("*.json")):
            with suppress(OSError, ValueError, TypeError, KeyError):
                task = Task(**parse_json(read_text(file)))
                kind, _ = task.request["kind"], task.facts["uses"]  # which one of another version may lack
                self._known[task.id] = task
                if task.state == "queued" and kind == "print":  # its turn never came
                    task.state, task.message = "cancelled", "Studio ended before the print began; start it again"

    def listed(self) -> list[dict[str, Any]]:
        """All tasks, newest first."""
        with self._lock:
            return [self.described(task) for task in reversed(self._known.values())]

    def one(self, name: str) -> Task:
        """A task. Raises `Refused`."""
        with self._lock:
            if name not in self._known:
                raise Refused(404, f"there is no task {name[:80]!r}; reload the list")
            return self._known[name]

    def busy(self) -> dict[str, str]:
        """State of the task that uses a name in the workspace."""
        with self._lock:
            some = [task for task in self._known.values() if task.state not in ENDED]
            return {name: "queued" if task.state == "queued" else "running"
                    for task in some for name in task.facts["uses"]}  # fmt: skip

    def printing(self) -> str | None:
        """The run of the print that is in progress."""
        with self._lock:
            return next((task.facts["run"] for task in self._known.values()
                         if task.state == "running" and task.request["kind"] == "print"), None)  # fmt: skip

    def described(self, task: Task) -> dict[str, Any]:
        """A task as the page gets it."""
        facts, result = task.facts, task.facts["result"] or ""
        resumable = task.state in ("failed", "cancelled") and task.request["kind"] == "solve"
        found = {
            "id": task.id, "kind": task.request["kind"], "state": task.state, "added": task.added,
            "began": task.began, "ended": task.ended, "status": task.status, "message": task.message,
            "device": task.request.get("device"), "request": task.request, "progress": task.shown,
            "resumable": resumable and self._workspace.is_interrupted(self._workspace.folder / result),
            **{key: facts.get(key) for key in ("job", "result", "rig", "run")},
            "made": facts["made"] if task.state == "done" else [],
        }  # fmt: skip
        if task.request["kind"] == "orient" and task.state == "done":
            with suppress(OSError, ValueError):
                found["orientations"] = parse_json(read_text(self._workspace.folder / facts["made"][0]))["best"]
        return found

    def add(self, request: dict[str, Any]) -> Task:
        """Put a task into the queue. Raises `Refused`."""
        command = Command(self._workspace, request)
        with self._lock:
            if len(self._known) >= MOST:
                raise Refused(409, f"there are {MOST} tasks; remove ended ones from the list")
            taken = {name for task in self._known.values() if task.state not in ENDED for name in task.facts["made"]}
            if clash := taken & set(command.made):
                raise Refused(409, f"another task writes {', '.join(sorted(clash))}; wait for its end, or cancel it")
            if command.kind == "print" and command.lane in self._lanes("queued", "running", "cancelling"):
                raise Refused(409, f"{command.rig} prints now; start this print when the vial is changed")
            stamp = time.strftime("%Y%m%d-%H%M%S")
            names = (f"{stamp}-{number:04d}-{command.kind}" for number in self._numbers)
            task = Task(next(name for name in names if name not in self._known), request, added=time.time())
            task.facts = {"job": command.job, "result": command.result, "rig": command.rig, "run": command.run,
                          "made": command.made, "lane": command.lane, "place": command.progress,
                          "arguments": command.arguments, "uses": sorted(command.uses())}  # fmt: skip
            self._known[task.id] = task
            self._changed(task)
        return task

    def cancel(self, name: str) -> Task:
        """Remove a task from the queue, or stop it as Ctrl-C does; a second request, after a while, kills it."""
        with self._lock:
            task = self.one(name)
            if task.state == "queued":
                self._end(task, STOPPED)
            elif task.state in ("running", "cancelling") and self._alive(task):
                late = task.state == "cancelling" and time.time() - task.asked > PATIENCE
                killed = late and task.request["kind"] != "print"  # a print must end its light itself
                with suppress(OSError):
                    os.killpg(task.pid, signal.SIGKILL if killed else signal.SIGINT)
                task.asked = task.asked or time.time()
                task.state = "cancelling"
                self._changed(task)
            elif task.state in ENDED:
                raise Refused(409, f"the task has ended: {task.state}")
        return task

    def resume(self, name: str) -> Task:
        """A new task that continues where one stopped. Raises `Refused`."""
        task = self.one(name)
        if not self.described(task)["resumable"]:
            raise Refused(409, "there is nothing to continue; start the task again")
        return self.add(task.request | {"fresh": False})

    def remove(self, name: str) -> None:
        """Remove an ended task from the list. Raises `Refused`."""
        with self._lock:
            task = self.one(name)
            if task.state not in ENDED:
                raise Refused(409, "the task has not ended; cancel it first")
            for file in (self._file(task), self._log(task)):
                file.unlink(missing_ok=True)
            del self._known[name]
            self._progress.pop(name, None)
        self._told("removed", {"id": name})

    def log(self, name: str) -> str:
        """The end of what a task printed."""
        task = self.one(name)
        try:
            with self._log(task).open("rb") as file:
                file.seek(max(0, os.fstat(file.fileno()).st_size - TAIL))
                return file.read(TAIL).decode("utf-8", "replace")
        except FileNotFoundError:
            return ""

    def history(self, name: str) -> dict[str, list[Any]]:
        """Steps of a task, thinned."""
        steps = self._read(self.one(name)).steps
        return thinned([{key: step[key] for key in STEP} for step in steps])

    def slice(self, name: str) -> np.ndarray:
        """The newest slice of a run. Raises `Refused`."""
        task = self.one(name)
        place = slice_path(self._workspace.folder / (task.facts["place"] or task.id))
        if not self._read(task).slices or not place.is_file():
            raise Refused(404, "the run has no slice yet; ask again when its count has grown")
        return np.array(map_npy(place))

    def poll(self) -> None:
        """Record which tasks ended and the progress of the others, and start the next ones."""
        with self._lock:
            for task in list(self._known.values()):
                if task.state in ("running", "cancelling"):
                    self._look(task)
            lanes = self._lanes("running", "cancelling")
            for task in list(self._known.values()):
                if task.state == "queued" and task.facts["lane"] not in lanes:
                    lanes.add(task.facts["lane"])
                    self._start(task)

    def _lanes(self, *states: str) -> set[str]:
        return {task.facts["lane"] for task in self._known.values() if task.state in states}

    def _start(self, task: Task) -> None:
        """Run the command in a session of its own; it holds a lock on its log as long as it lives."""
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
                                    "COLUMNS": "120", "PYTHONUNBUFFERED": "1",
                                    "PYTHONSAFEPATH": "1"}  # fmt: skip  # the workspace holds no modules
        task.state, task.began = "running", time.time()
        try:
            with self._log(task).open("wb") as log:
                locked(log.fileno())
                child = subprocess.Popen(
                    [sys.executable, "-m", "vamgpu.cli", *task.facts["arguments"]], cwd=self._workspace.folder,
                    stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, env=environment,
                    start_new_session=True,
                )  # fmt: skip
        except OSError as error:
            task.message = f"the task did not start: {error}"
            return self._end(task, 1)
        self._children[task.id], task.pid = child, child.pid
        self._changed(task)

    def _alive(self, task: Task) -> bool:
        child = self._children.get(task.id)
        if child is not None:
            return child.poll() is None
        try:
            with self._log(task).open("rb") as log:
                return not locked(log.fileno())
        except OSError:
            return False

    def _look(self, task: Task) -> None:
        alive = self._alive(task)  # before reading the progress, which may end in between
        progress, before = self._read(task), task.shown
        task.shown = None if not progress.pid else {
            "stage": progress.stage, "said": progress.said, "share": progress.share, "left": progress.left,
            "stages": progress.stages, "notes": progress.notes, "warnings": progress.warnings, "wall": progress.wall,
            "slices": progress.slices, **(progress.steps[-1] if progress.steps else dict.fromkeys(STEP)),
        }  # fmt: skip
        if not alive:
            child = self._children.pop(task.id, None)
            known = progress.status if child is None else child.returncode
            if known is None:  # it ended while no server watched
                known = 0 if newest(self._workspace, task.facts["made"]) >= (task.began or 0.0) else 1
            self._end(task, known)
        elif task.shown != before:
            self._told("task", self.described(task))

    def _end(self, task: Task, status: int) -> None:
        progress, lines = self._read(task), self.log(task.id).strip().splitlines()
        errors = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
        stopped = status == STOPPED or (task.state == "cancelling" and status != 0)
        task.state = "cancelled" if stopped or not task.began else "done" if status == 0 else "failed"
        task.status, task.ended = status, time.time()
        said = progress.verdict["sentence"] if progress.verdict else lines[-1] if lines else ""
        if not task.message:
            task.message = "\n".join(errors) if errors and task.state == "failed" else said
        solved = task.state == "done" and task.request["kind"] == "solve" and task.facts["result"].endswith(RESULT)
        if solved and task.request["prove"]:
            with suppress(VamError):
                self.add({"kind": "prove", "result": task.facts["result"], "device": task.request["device"],
                          "tolerances": False})  # fmt: skip
        self._changed(task)

    def _read(self, task: Task) -> RunProgress:
        """The progress of a task; that of another run in the same place does not count."""
        place = self._workspace.folder / (task.facts["place"] or task.id)
        progress = self._progress.setdefault(task.id, RunProgress(place))
        with self._lock:  # two readers at once would skip what one of them read
            if task.state not in ENDED or not progress.pid:
                progress.read()
        return progress if progress.pid == task.pid else RunProgress(place)

    def _changed(self, task: Task) -> None:
        facts = {key: getattr(task, key) for key in task.__dataclass_fields__}
        with suppress(OSError), replacing(self._file(task), overwrite=True) as draft:
            draft.write_text(json.dumps(facts), encoding="utf-8")
        self._told("task", self.described(task))

    def _file(self, task: Task) -> Path:
        return self._folder / f"{task.id}.json"

    def _log(self, task: Task) -> Path:
        return self._folder / f"{task.id}.log"


def thinned(steps: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """Columns of steps, at most `POINTS` long."""
    chosen = np.unique(np.linspace(0, len(steps) - 1, min(len(steps), POINTS)).round().astype(int)) if steps else ()
    return {key: [steps[k].get(key) for k in chosen] for key in STEP}
