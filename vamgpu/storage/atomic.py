"""Write beside the place, move there at the end: nothing half-written ever looks finished."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vamgpu.errors import StorageError

REMEDIES = {
    errno.ENOSPC: "the disk is full: free some space or choose another place",
    errno.EDQUOT: "the disk quota is used up: free some space or choose another place",
    errno.EFBIG: "the file grew beyond what the system allows: raise the limit or choose another place",
    errno.EACCES: "no permission: choose a place you may write to",
    errno.ENOENT: "its folder does not exist: make it or choose another path",
    errno.EROFS: "the disk is read-only: choose another place",
}

PAGES = (".html", ".htm")


def explained(action: str, path: Path, error: OSError) -> StorageError:
    """A `StorageError` that says what failed and what to do about it."""
    remedy = REMEDIES.get(error.errno or 0, "check the path and the disk")
    return StorageError(f"cannot {action} {str(path)!r}: {error.strerror or error}; {remedy}")


def page_path(path: str | Path) -> Path:
    """The path of a report, which replaces what stands there: only an .html. Raises `StorageError` for another."""
    if Path(path).suffix.lower() not in PAGES:
        raise StorageError(f"the report {str(path)!r} would be a page; wanted a path ending in .html: choose another")
    return Path(path)


def named(path: Path) -> Path:
    """The whole path, so that it has a name even where it was given as ``.``. Raises `StorageError` for one without."""
    whole = path.resolve()
    if not whole.name or not str(path).strip():
        raise StorageError(f"{str(path)!r} has no name; expected a file or a folder: check the path")
    return whole


@contextmanager
def replacing(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Hand out a path in a fresh folder beside ``path``; what is written there is moved to ``path`` at the end.

    After any exception, a keyboard interrupt included, nothing is left and what stood at ``path`` still stands.
    Raises `StorageError` for a path that is taken (unless ``overwrite``), for a full disk, and whatever else the
    system refuses.
    """
    place = Path(path)
    if os.path.lexists(place) and not overwrite:
        raise StorageError(f"{str(path)!r} exists; choose another path, or allow overwriting it")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        workshop = Path(tempfile.mkdtemp(prefix=f".{place.name}.partial-", dir=place.parent))
    except OSError as error:
        raise explained("write beside", place, error) from error
    try:
        draft = workshop / place.name
        yield draft
        _move(draft, place, workshop)
    except OSError as error:
        if isinstance(error, StorageError):
            raise
        raise explained("write", place, error) from error
    finally:
        shutil.rmtree(workshop, ignore_errors=True)


def _move(draft: Path, place: Path, workshop: Path) -> None:
    """Put the draft in place; a folder that stands there steps aside first and returns should that fail."""
    if not (place.is_dir() and not place.is_symlink()):
        os.replace(draft, place)
        return
    aside = workshop / "replaced"
    os.replace(place, aside)
    try:
        os.replace(draft, place)
    except OSError:
        os.replace(aside, place)
        raise
