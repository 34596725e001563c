"""A folder of parts, job files, job folders and runs, as the command line leaves them."""

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
from vamgpu.jobs.progress import RunProgress
from vamgpu.jobs.read import Job, checked_toml, read_text
from vamgpu.jobs.web import is_web_folder
from vamgpu.methods.plan_folder import INTERRUPTED
from vamgpu.storage.atomic import locked
from vamgpu.storage.folder import MANIFEST, Folder
from vamgpu.targets.mesh import FORMATS

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,79}")
"""Names of files and folders in requests: without separators and leading dots, they cannot leave the workspace."""
JOB, RESULT, PROOF = ".toml", ".vam", ".proof"
OWN = ".studio"
"""Folder in the workspace for tasks, own presets and the lock."""
TRASH = "trash"
REMEMBERED = 500
"""Files whose content is remembered."""
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
    """What changes with the content of a file: inode, time and size; zeros if there is none."""
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
        """The value of a file."""
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
    """One folder; all names in requests are resolved here.

    Args:
        given: The folder, or a file or job folder in it, which the page opens.

    Raises:
        StorageError: The folder cannot be used, or another Studio serves it.
    """

    def __init__(self, given: Path) -> None:
        inside = given.suffix.lower() in (JOB, RESULT, *FORMATS)
        if inside and not given.exists():
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
                   if name.endswith(RESULT) and (self.folder / name / MANIFEST).is_file()]  # fmt: skip
        known = {result["id"]: result for result in results}
        trash = self.folder / TRASH
        return {
            "name": self.folder.name, "opened": self.opened,
            "parts": [self._file(name) for name in files if Path(name).suffix.lower() in FORMATS],
            "jobs": [self._job(name, kind, known, busy) for name, kind in texts.items() if kind != "rig"],
            "results": results,
            "rigs": [{"id": "emulated"}, *({"id": name} for name, kind in texts.items() if kind == "rig")],
            "trash": len(os.listdir(trash)) if trash.is_dir() else 0,
        }  # fmt: skip

    def _file(self, name: str) -> dict[str, Any]:
        found = (self.folder / name).stat()
        return {"id": name, "bytes": found.st_size, "modified": found.st_mtime}

    def _job(self, name: str, kind: str, results: dict[str, Any], busy: dict[str, str]) -> dict[str, Any]:
        path, result = self.folder / name, Path(name).with_suffix(RESULT).name
        error, part = ("", None) if kind != "vial" else self.remembered.of("job", path, _checked)
        error, part = _checked(path) if error else (error, part)  # its mesh may have come since
        found, modified = results.get(result), path.stat().st_mtime
        if name in busy:
            state = busy[name]
        elif RunProgress(self.folder / result).running:
            state = "running"
        elif found is None:
            state = "invalid" if error else "new"
        elif found["state"] != "interrupted" and modified > found["modified"]:
            state = "changed"
        else:
            state = found["state"]
        return {"id": name, "modified": modified, "kind": kind, "part": part, "error": error, "state": state,
                "result": None if found is None else result}  # fmt: skip

    def _result(self, name: str, busy: dict[str, str]) -> dict[str, Any]:
        path, job = self.folder / name, Path(name).with_suffix(JOB).name
        state, verdict = self.state(path)
        size = sum(each.stat().st_size for each in path.rglob("*") if each.is_file())
        return {"id": name, "modified": (path / MANIFEST).stat().st_mtime, "bytes": size, "state": state,
                "verdict": verdict, "job": job if (self.folder / job).is_file() else None}  # fmt: skip

    def state(self, path: Path) -> tuple[str, dict[str, Any] | None]:
        """State and verdict of a job folder."""
        if is_web_folder(path):
            return "web", None
        try:
            if INTERRUPTED in self.manifest(path).manifest.inputs:
                return "interrupted", None
            proof = self.proof_of(path)
            judged = None if proof is None else self.manifest(proof).manifest.details.get("judged")
        except VamError:
            return "damaged", None
        if judged is None:
            return "solved", None
        return "proved", {key: judged["verdict"][key] for key in ("prints", "proved", "sentence")}

    def manifest(self, path: Path) -> Folder:
        """An opened job folder."""
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
    if "target" in tables or "body" in tables:
        return "web" if "roller" in tables else "vial"
    return "rig" if "motion" in tables and "display" in tables else "other"


def _checked(path: Path) -> tuple[str, str | None]:
    """What is wrong with a job file, and the name of its part in the workspace."""
    try:
        file = Job.read(path).file
    except JobError as error:
        return str(error), None
    except (ValueError, OSError) as error:
        return f"{path.name}: {error}", None
    return "", file.target.mesh
