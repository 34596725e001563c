"""A folder of parts, job files, job folders and runs, in the form that the command line writes."""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from vamgpu.errors import BadInput, JobError, StorageError, VamError, WrongKey
from vamgpu.jobs.curethrough import CurethroughJob
from vamgpu.jobs.progress import RunProgress, events_path
from vamgpu.jobs.read import CheckedJob, Job, checked_toml, read_text
from vamgpu.jobs.web import WebJob, is_web_folder
from vamgpu.methods.plan_folder import INTERRUPTED
from vamgpu.storage.atomic import locked
from vamgpu.storage.folder import MANIFEST, Folder
from vamgpu.storage.manifest import plain
from vamgpu.targets.mesh import FORMATS
from vamgpu.webs.store import RECORD, WebFolder

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,79}")
"""Names of files and folders in requests: without separators and leading dots, they cannot leave the workspace."""
JOB, RESULT, PROOF = ".toml", ".vam", ".proof"
READERS: dict[str, type[CheckedJob[Any]]] = {"vial": Job, "web": WebJob, "slices": CurethroughJob}
"""Kind of a job → what reads its file."""
OWN = ".studio"  # folder in the workspace for tasks, own presets and the lock
TRASH = "trash"
REMEMBERED = 500  # files whose content is remembered
Value = TypeVar("Value")
Stamp = tuple[int, int, int]


class Refused(VamError):
    """A request that is answered with an error; ``status`` is that of HTTP."""

    status: int
    wrong: tuple[WrongKey, ...]

    def __init__(self, status: int, message: str, wrong: tuple[WrongKey, ...] = ()) -> None:
        super().__init__(message)
        self.status, self.wrong = status, wrong


def stamp(path: Path) -> Stamp:
    """A stamp that changes with the content of a file: inode, time and size; zeros if there is none."""
    with suppress(OSError):
        found = os.stat(path)
        return found.st_ino, found.st_mtime_ns, found.st_size
    return 0, 0, 0


class Remembered:
    """Values computed from files, until the files change."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, Path], tuple[Stamp, Any]] = {}
        self._lock = Lock()

    def of(self, what: str, path: Path, made: Callable[[Path], Value]) -> Value:
        key, now = (what, path), stamp(path)
        with self._lock:
            if key in self._known and self._known[key][0] == now:
                return self._known[key][1]
        value = made(path)
        with self._lock:
            if len(self._known) >= REMEMBERED:
                del self._known[next(iter(self._known))]
            self._known[key] = now, value
        return value


class Workspace:
    """One folder, or what the page opens in it; resolves all names in requests. Raises `BadInput`, `StorageError`."""

    def __init__(self, given: Path) -> None:
        inside = given.suffix.lower() in (JOB, RESULT, *FORMATS)
        if not given.exists():
            raise BadInput(f"there is no {str(given)!r}; expected a folder, a job file, a mesh or a job folder")
        whole = given.resolve()
        self.folder: Path = whole.parent if inside else whole
        self.opened: str | None = whole.name if inside and NAME.fullmatch(whole.name) else None
        self.own: Path = self.folder / OWN
        try:
            self.own.mkdir(0o700, parents=True, exist_ok=True)
            self.own.chmod(0o700)  # logs of prints hold the token of their page
            (self.own / "tasks").mkdir(exist_ok=True)
            self._lock = os.open(self.own / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            alone = locked(self._lock)
        except OSError as error:
            raise StorageError(f"cannot use {str(self.folder)!r} as a workspace: {error.strerror}; choose another "
                               "folder") from error  # fmt: skip
        if not alone:
            os.close(self._lock)
            raise StorageError(f"another Studio serves {str(self.folder)!r}; use its page, or choose another folder")
        self.remembered: Remembered = Remembered()

    def close(self) -> None:
        """Let another Studio serve the folder."""
        os.close(self._lock)

    def place(self, name: str, *endings: str) -> Path:
        """The path of a name with one of some endings. Raises `Refused` for other names."""
        if not NAME.fullmatch(name) or name.endswith((".", " ")):
            raise Refused(400, f"got the name {name[:80]!r}; expected letters, digits and ._- without a leading dot")
        if endings and not name.lower().endswith(endings):
            raise Refused(400, f"got {name!r}; expected a name ending in {', '.join(endings)}")
        return self.folder / name

    def existing(self, name: str, *endings: str) -> Path:
        """The path of something that is there; links are not followed. Raises `Refused`."""
        path = self.place(name, *endings)
        if path.is_symlink() or not path.exists():
            raise Refused(404, f"there is no {name!r} in the workspace; reload the list")
        return path

    def discard(self, name: str, *endings: str) -> None:
        """Move something to the folder of discarded things."""
        path, trash = self.existing(name, *endings), self.folder / TRASH
        trash.mkdir(exist_ok=True)
        shutil.move(path, trash / f"{time.time_ns() // 1_000_000}-{name}")

    def listing(self, busy: dict[str, str]) -> dict[str, Any]:
        """Everything in the workspace. busy: state of the task that uses a job file or a job folder, by its name."""
        names = {entry.name: entry for entry in os.scandir(self.folder)
                 if NAME.fullmatch(entry.name) and not entry.is_symlink()}  # fmt: skip
        files = sorted(name for name, entry in names.items() if entry.is_file())
        folders = sorted(name for name, entry in names.items() if entry.is_dir())
        texts = {name: self.remembered.of("kind", self.folder / name, kind_of) for name in files if name.endswith(JOB)}
        results = [self._result(name, busy) for name in folders
                   if name.endswith(RESULT) and record_of(self.folder / name).is_file()]  # fmt: skip
        known = {result["id"]: result for result in results}
        trash = self.folder / TRASH
        return {
            "name": self.folder.name, "opened": self.opened,
            "parts": [{"id": name, "bytes": found.st_size, "modified": found.st_mtime} for name in files
                      if Path(name).suffix.lower() in FORMATS for found in [names[name].stat()]],
            "jobs": [self._job(name, kind, known, busy) for name, kind in texts.items() if kind != "rig"],
            "results": results,
            "rigs": [{"id": "emulated"}, *({"id": name} for name, kind in texts.items() if kind == "rig")],
            "trash": len(os.listdir(trash)) if trash.is_dir() else 0,
        }  # fmt: skip

    def _job(self, name: str, kind: str, results: dict[str, Any], busy: dict[str, str]) -> dict[str, Any]:
        path, result = self.folder / name, Path(name).with_suffix(RESULT).name
        read = self.remembered.of("job", path, _read) if kind in READERS else ("", None)
        error, job = _read(path) if read[0] else read  # its mesh may have come since
        found, modified = results.get(result), path.stat().st_mtime
        if isinstance(job, CurethroughJob) and (place := self.corrected(job)) is not None:
            state, verdict = self.reported(place.with_name(f"{place.stem}.html"), place)
            found, result = {"state": state, "verdict": verdict}, place.name
        if name in busy:
            state = busy[name]
        elif RunProgress(self.folder / result).running:
            state = "running"
        elif found is None:
            state = "invalid" if error else "new"
        elif found["state"] in ("solved", "proved") and job is not None and self._changed(self.folder / result, job):
            state = "changed"
        else:
            state = found["state"]
        part = None if job is None else getattr(job.file, "slices" if kind == "slices" else "target").mesh
        return {"id": name, "modified": modified, "kind": kind, "part": part, "error": error, "state": state,
                "result": None if found is None else result,
                "verdict": None if found is None else found["verdict"]}  # fmt: skip

    def corrected(self, job: CurethroughJob) -> Path | None:
        """The corrected slices of a job in this folder, if there are any."""
        place = job.beside()
        return place if place.parent == self.folder and place.exists() and not place.is_symlink() else None

    def _changed(self, result: Path, job: CheckedJob[Any]) -> bool:
        """Whether the keys of a job file differ from those of its result."""
        if isinstance(job, Job):
            return _differ(self.manifest(result).manifest.inputs.get("job"), job)
        return self.differs(result if is_web_folder(result) else result.with_name(f"{result.stem}.html"), job)

    def differs(self, place: Path, job: CheckedJob[Any]) -> bool:
        """Whether a job has other keys than the run that wrote a place."""
        return _differ(self._recorded(place).job, job)

    def _recorded(self, place: Path) -> RunProgress:
        """The progress of a run that has ended."""

        def read(_: Path) -> RunProgress:
            found = RunProgress(place)
            found.read()
            return found

        return self.remembered.of("progress", events_path(place), read)

    def reported(self, page: Path, made: Path) -> tuple[str, dict[str, Any] | None]:
        """State and verdict that a run recorded when it wrote a report on what was ``made``, unless that is newer."""
        found = self._recorded(page).verdict if stamp(page)[1] >= stamp(made)[1] > 0 else None
        return ("solved", None) if found is None else ("proved", {**found, "proved": True, "remedies": []})

    def _result(self, name: str, busy: dict[str, str]) -> dict[str, Any]:
        path, job = self.folder / name, Path(name).with_suffix(JOB).name
        state, verdict = self.state(path)
        size = sum(each.stat().st_size for each in path.rglob("*") if each.is_file())
        return {"id": name, "modified": record_of(path).stat().st_mtime, "bytes": size, "state": state,
                "kind": "web" if is_web_folder(path) else "vial", "verdict": verdict,
                "job": job if (self.folder / job).is_file() else None}  # fmt: skip

    def web(self, path: Path) -> WebFolder:
        """An opened folder of a web. Raises `StorageError`."""
        return self.remembered.of("web", path / RECORD, lambda file: WebFolder.open(file.parent))

    def state(self, path: Path) -> tuple[str, dict[str, Any] | None]:
        """State and verdict of a job folder."""
        try:
            if is_web_folder(path):
                whole = self.web(path).complete
                return self.reported(path.with_suffix(".html"), path / RECORD) if whole else ("interrupted", None)
            if INTERRUPTED in self.manifest(path).manifest.inputs:
                return "interrupted", None
            proof = self.proof_of(path)
            judged = None if proof is None else self.manifest(proof).manifest.details.get("judged")
        except VamError:
            return "damaged", None
        if judged is None:
            return "solved", None
        return "proved", {key: judged["verdict"][key] for key in ("prints", "proved", "sentence")}

    def is_interrupted(self, path: Path) -> bool:
        """Whether a job folder holds a run that can continue."""
        return path.suffix == RESULT and record_of(path).is_file() and self.state(path)[0] == "interrupted"

    def manifest(self, path: Path) -> Folder:
        return self.remembered.of("folder", path / MANIFEST, lambda file: Folder.open(file.parent))

    def proof_of(self, path: Path) -> Path | None:
        """The proof of a job folder, unless the job was solved again since."""
        proof = path.with_suffix(PROOF)
        return proof if stamp(proof / MANIFEST)[1] > stamp(path / MANIFEST)[1] else None


def kind_of(path: Path) -> str:
    """What a TOML file describes: vial, web, rig or other."""
    try:
        tables = checked_toml(read_text(path))
    except JobError:
        return "other"
    return kind_of_tables(tables)


def kind_of_tables(tables: dict[str, Any]) -> str:
    """What the tables of a TOML file describe."""
    if "target" in tables or "body" in tables:
        return "web" if "roller" in tables else "vial"
    if "printer" in tables:
        return "slices"
    return "rig" if "motion" in tables and "display" in tables else "other"


def record_of(path: Path) -> Path:
    """The file of a job folder that is written last."""
    return path / RECORD if is_web_folder(path) else path / MANIFEST


def _read(path: Path) -> tuple[str, CheckedJob[Any] | None]:
    """What is wrong with a job file, and the job if nothing is."""
    try:
        return "", READERS[kind_of(path)].read(path)
    except JobError as error:
        return str(error), None
    except (ValueError, OSError) as error:
        return f"{path.name}: {error}", None


def _differ(made: dict[str, Any] | None, job: CheckedJob[Any]) -> bool:
    """Whether keys differ from those of a job; its device does not count."""
    return made is not None and _without_device(made) != _without_device(plain(job.given))


def _without_device(tables: dict[str, Any]) -> dict[str, Any]:
    """The tables of a job without its device, and without tables that are empty."""
    kept = {name: {key: value for key, value in table.items() if key != "device"} if isinstance(table, dict) else table
            for name, table in tables.items()}  # fmt: skip
    return {name: table for name, table in kept.items() if table}
