"""Write to a temporary place and move the result at the end: an incomplete file never looks complete."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vamgpu.errors import BadInput, StorageError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None
REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space or choose another place",
    errno.EDQUOT: "the disk quota is used up: free some space or choose another place",
    errno.EFBIG: "the file grew beyond what the system allows: raise the limit or choose another place",
    errno.EACCES: "no permission: choose a place you may write to",
    errno.ENOENT: "its folder does not exist: make it or choose another path",
    errno.EROFS: "the disk is read-only: choose another place",
}

PAGES = (".html", ".htm")


def as_path(path: str | Path) -> Path:
    if not isinstance(path, str | os.PathLike):
        raise BadInput(f"got a {type(path).__name__} where a path is expected; give text or a Path")
    return Path(path)


def explained(action: str, path: Path, error: OSError | ValueError) -> StorageError:
    """Explain an error of the system, and its remedy."""
    remedy = REMEDIES.get(getattr(error, "errno", None) or 0, "check the path and the disk")
    return StorageError(f"cannot {action} {str(path)!r}: {getattr(error, 'strerror', None) or error}; {remedy}")


@contextmanager
def explaining(action: str, path: Path) -> Iterator[None]:
    """Raise errors of the system as `explained`, and `StorageError` as it is."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        raise explained(action, path, error) from error


def page_path(path: str | Path) -> Path:
    """The path of a report, which replaces an existing file."""
    if Path(path).suffix.lower() not in PAGES:
        raise StorageError(f"the report {str(path)!r} would be a page; expected a path ending in .html: choose another")
    return Path(path)


def named(path: Path) -> Path:
    """Resolve a path; it then has a name even if it was given as ``.``."""
    whole = path.resolve()
    if not whole.name or not str(path).strip():
        raise StorageError(f"{str(path)!r} has no name; expected a file or a folder: check the path")
    return whole


def check_folder(place: Path) -> None:
    """Reject a path in a folder that does not exist, because a typing error would make folders in wrong places."""
    if not place.parent.is_dir():
        raise StorageError(f"cannot write {str(place)!r}: the folder {str(place.parent)!r} does not exist; make it, or "
                           "choose another path")  # fmt: skip


@contextmanager
def replacing(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a path in a new folder beside ``path``; its content is moved to ``path`` at the end."""
    # After any exception, including a keyboard interrupt, nothing is left and the old content of ``path`` is unchanged.
    # Leftovers of a killed run are removed first, see `clear`.
    place = Path(path)
    clear(place)
    if os.path.lexists(place) and not overwrite:
        raise StorageError(f"{str(path)!r} exists; choose another path, or allow overwriting it (--overwrite)")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        workshop, lock = _workshop(place)
    except (OSError, ValueError) as error:  # a name that no file can have
        raise explained("write beside", place, error) from error
    try:
        draft = workshop / place.name
        yield draft
        _move(draft, place, workshop)
        settle(place.parent)
    except OSError as error:
        if isinstance(error, StorageError):
            raise
        raise explained("write", place, error) from error
    finally:
        shutil.rmtree(workshop, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def settle(*places: Path) -> None:
    """Flush files, or the names in folders, to the disk; they then survive a power failure."""
    for place in places:
        if place.is_dir() and not hasattr(os, "O_DIRECTORY"):
            continue
        handle = os.open(place, os.O_RDONLY if place.is_dir() else os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def clear(path: str | Path) -> None:
    """Remove leftovers of killed runs beside ``path``, and complete the last move of a run if only that was missing."""
    # Folders that a run still writes to are locked and stay; without locks, on Windows, all stay.
    place = Path(path)
    try:
        left = [Path(entry.path) for entry in os.scandir(place.parent) if entry.name.startswith(_prefix(place))]
    except (OSError, ValueError):
        return  # the system reports its own error when the place is written to
    for workshop in left:
        try:
            lock = _locked(workshop)
        except OSError:
            continue
        if lock is None:
            continue
        try:
            draft, aside = workshop / place.name, _aside(workshop, place)
            if os.path.lexists(aside) and not os.path.lexists(place):
                os.replace(draft if os.path.lexists(draft) else aside, place)
            shutil.rmtree(workshop, ignore_errors=True)
        except OSError:
            continue
        finally:
            os.close(lock)


def _prefix(place: Path) -> str:
    return f".{place.name}.partial-"


def _aside(workshop: Path, place: Path) -> Path:
    """Where the old content of a place is kept while the new content is moved there."""
    return workshop / f"{place.name}.replaced"


def _workshop(place: Path) -> tuple[Path, int | None]:
    """A new folder, and the lock that marks it as in use."""
    while True:
        workshop = Path(tempfile.mkdtemp(prefix=_prefix(place), dir=place.parent))
        try:
            lock = _locked(workshop)
        except (FileNotFoundError, BlockingIOError):  # another run removes it
            continue
        if workshop.exists():
            return workshop, lock
        if lock is not None:
            os.close(lock)


def locked(file: int) -> bool:
    """Lock an open file or folder until all its descriptors are closed; False if another one holds the lock."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _locked(folder: Path) -> int | None:
    """A lock on a folder, which ends with this process; None if the file system has no locks."""
    if fcntl is None:
        return None
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        if locked(lock):
            return lock
    except OSError:
        os.close(lock)
        return None
    os.close(lock)
    raise BlockingIOError


def _move(draft: Path, place: Path, workshop: Path) -> None:
    """Put the draft in place; an existing folder is moved aside first, and moved back if this fails."""
    if not (place.is_dir() and not place.is_symlink()):
        os.replace(draft, place)
        return
    aside = _aside(workshop, place)
    os.replace(place, aside)
    try:
        os.replace(draft, place)
    except OSError:
        os.replace(aside, place)
        raise
