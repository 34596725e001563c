"""The folder of compiled kernels, also for drivers that fail if the user's own cache folder cannot be written."""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path

from vamgpu.errors import StorageError

VARIABLE = "XDG_CACHE_HOME"
"""Environment variable from which PoCL, pyopencl and Warp find the user's cache folder on Linux."""


@cache
def refusal() -> str:
    """Why the system refuses to write the user's cache folder; empty if it can be written."""
    place = Path(os.path.expanduser(os.environ.get(VARIABLE) or "~/.cache"))
    if str(place).startswith("~"):
        return "this user has no home folder"
    try:
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=place):
            return ""
    except OSError as error:
        return str(error)


@cache
def writable() -> tempfile.TemporaryDirectory[str] | None:
    """Keep drivers' kernels in a folder of this process if the user's cache is read-only. Raises `StorageError`."""
    if sys.platform in ("win32", "darwin") or not refusal():
        return None
    try:
        folder = tempfile.TemporaryDirectory(prefix="vamgpu-kernels-", ignore_cleanup_errors=True)
    except OSError as error:
        raise StorageError(
            f"cannot keep compiled kernels: {refusal()}, nor in a temporary folder: {error}; set {VARIABLE} or TMPDIR "
            "to a folder that this user may write"
        ) from error
    os.environ[VARIABLE] = folder.name
    return folder


def kept(key: str) -> bytes | None:
    """What `keep` has stored under a key."""
    with suppress(OSError):
        return (user_cache_path("vamgpu", False) / key).read_bytes()
    return None


def keep(key: str, content: bytes) -> None:
    """Store bytes atomically in the user's cache, if it can be written."""
    with suppress(OSError):
        folder = user_cache_path("vamgpu", False, ensure_exists=True)
        with tempfile.TemporaryDirectory(dir=folder) as draft:
            (Path(draft) / key).write_bytes(content)
            os.replace(Path(draft) / key, folder / key)
