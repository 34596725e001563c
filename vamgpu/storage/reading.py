"""The only entry: every file that the library reads is opened here.

Only regular files are opened, so that reading never waits; sizes and depths are checked before data are used.
"""

from __future__ import annotations

import json
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EINVAL
from math import isfinite
from pathlib import Path
from typing import Any, BinaryIO

from vamgpu.errors import BadInput, StorageError, VamError
from vamgpu.storage.memory import size

MOST_TEXT = 64_000_000
"""Size of the largest text that is read whole [bytes]: the record of a web of 100 m has 20 million."""
MOST_RECORD = 4_000_000_000  # size of the largest record of a run [bytes]; a frame takes 56
MOST_TOML = 2_000_000  # size of the largest TOML file [bytes]: its parser is slow, and people write such files by hand
MOST_PARTS = 64  # parts of the longest dotted key, because the parser's time and memory grow with their square
MOST_LEVELS = 64  # greatest depth of nested tables and lists
MOST_INTEGER = 1 << 63  # limit of integers in TOML, and in most readers of JSON
KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe (FIFO)"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
LONG_KEY = re.compile(
    rf"""(?<![^\s,=\[\]{{}}#])(?:(?:"[^"\n]*"|'[^'\n]*'|[^\s.,=\[\]{{}}#"']+)[ \t]*\.[ \t]*){{{MOST_PARTS}}}"""
)
PROSE = re.compile(r'''"""(?:\\.|[^\\])*?"""|"(?:\\.|[^"\\\n])*"|#[^\n]*''' + r"|'''.*?'''|'[^'\n]*'", re.DOTALL)
"""Text and comments; periods in them are not separators."""


def is_file(path: str | Path) -> bool:
    """Whether a path is a regular file; no path, however unusual, raises an error."""
    return os.path.isfile(path)


def open_file(path: str | Path) -> BinaryIO:
    """Open a regular file for reading its bytes."""
    try:
        _regular(os.stat(path).st_mode, path)
        flags = ("O_RDONLY", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY")  # no wait if a pipe replaced the file meanwhile
        file = os.open(path, sum(getattr(os, name, 0) for name in flags))
    except ValueError as error:  # a name that no file can have
        raise OSError(EINVAL, str(error), str(path)) from error
    try:
        _regular(os.fstat(file).st_mode, path)
        return os.fdopen(file, "rb")
    except BaseException:
        os.close(file)
        raise


def read_bytes(path: str | Path, most: int = MOST_TEXT) -> bytes:
    """The bytes of a regular file."""
    with open_file(path) as file:
        found = os.fstat(file.fileno()).st_size
        if found > most:
            raise OSError(EINVAL, f"it has {size(found)}, expected {size(most)} at most", str(path))
        return file.read(found)


def read_text(path: str | Path, most: int = MOST_TEXT) -> str:
    """The text of a regular file in UTF-8."""
    return read_bytes(path, most).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


def load_toml(
    path: str | Path, what: str, *, missing: type[VamError] = StorageError, wrong: type[VamError] = BadInput
) -> dict[str, Any]:
    """The tables of a TOML file."""
    try:
        return parse_toml(read_text(path))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise missing(f"cannot read {what} {str(path)!r}: {reason}; expected a TOML file: check the path") from error
    except tomllib.TOMLDecodeError as error:
        raise wrong(f"{path}: not valid TOML: {error}; correct that line") from error


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text."""
    if len(text) > MOST_TOML:
        raise tomllib.TOMLDecodeError(f"{len(text):,} characters, expected {MOST_TOML:,} at most")
    if LONG_KEY.search(text) and LONG_KEY.search(PROSE.sub('""', text)):
        raise tomllib.TOMLDecodeError(f"a key of more than {MOST_PARTS} parts")
    try:
        data = tomllib.loads(text)
        _check(data)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise tomllib.TOMLDecodeError(f"more than {MOST_LEVELS} nested tables or lists") from error
    except ValueError as error:
        raise tomllib.TOMLDecodeError(str(error)) from error
    return data


def parse_json(text: str | bytes, *, finite: bool = True) -> Any:
    """The value of a JSON text. Raises `ValueError`."""
    try:
        data = json.loads(text)
    except RecursionError as error:
        raise ValueError(f"more than {MOST_LEVELS} nested objects or lists") from error
    _check(data, finite=finite)
    return data


def _regular(mode: int, path: str | Path) -> None:
    if not stat.S_ISREG(mode):
        kind = next((name for test, name in KINDS if test(mode)), "something else")
        raise OSError(EINVAL, f"it is {kind}, expected a file", str(path))


def _check(data: Any, finite: bool = False) -> None:
    """Raise `ValueError` for data that is nested too deeply, and for numbers that are too large or not finite."""
    level: list[Any] = [data]
    for _ in range(MOST_LEVELS + 1):
        deeper: list[Any] = []
        for value in level:
            if isinstance(value, (dict, list)):
                deeper.extend(value.values() if isinstance(value, dict) else value)
            elif isinstance(value, int) and not -MOST_INTEGER <= value < MOST_INTEGER:
                raise ValueError(f"an integer of {value.bit_length()} bits, expected 64 at most")
            elif finite and isinstance(value, float) and not isfinite(value):
                raise ValueError(f"the number {value}, expected a finite one")
        if not deeper:
            return
        level = deeper
    raise ValueError(f"more than {MOST_LEVELS} nested tables or lists")


@contextmanager
def malformed(what: str, remedy: str) -> Iterator[None]:
    """Raise `StorageError` if values in ``what`` are missing or wrong; one that is raised inside stays as it is."""
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise StorageError(f"{what}: {error}; {remedy}") from error
