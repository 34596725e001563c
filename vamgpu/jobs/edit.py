"""Change keys in the text of a job file; comments, order and blank lines stay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from vamgpu.errors import JobError
from vamgpu.jobs.keys import bare, toml_of
from vamgpu.jobs.lines import KeyPlace, Path, key_places
from vamgpu.jobs.read import checked_toml


def edited(text: str, changes: Mapping[str, Any], removed: Iterable[str] = ()) -> str:
    """A job file's text with other values.

    Args:
        text: Valid TOML.
        changes: New values by key: "vial.radius", or "body.0.dose" for the first [[body]]; the number of a body that
            follows the last one adds it.
        removed: Keys and tables to remove; missing ones are ignored.

    Raises:
        JobError: The text is not valid TOML, or a key cannot be changed in it.
    """
    for key in removed:
        text = _changed(text, key, None)
    for key, value in changes.items():
        text = _changed(text, key, value)
    return text


def _changed(text: str, key: str, value: Any) -> str:
    """The text with one key set, or removed for None."""
    path = tuple(key.split("."))
    data = checked_toml(text)
    if not _set(data, path, value):
        return text
    places = key_places(text)
    parts = [path[:k] for k in range(1, len(path) + 1)]
    inline = next((part for part in parts if part in places and places[part].value is not None), None)
    if inline is None or (inline == path and value is None):
        new = _without(text, places, path) if value is None else _added(text, places, path, toml_of(value))
    else:
        place, whole = places[inline], _get(data, inline)
        new = text[: place.value] + toml_of(whole) + text[place.end :]
    if checked_toml(new) != data:
        raise JobError(f"{key} cannot be changed in this file; expected tables with one key a line: edit its text")
    return new


def _get(data: Any, path: Path) -> Any:
    for part in path:
        data = data[int(part)] if isinstance(data, list) else data[part]
    return data


def _set(data: Any, path: Path, value: Any) -> bool:
    """Set or remove a value in parsed tables; False if there is nothing to remove. Raises `JobError`."""
    last = path[-1]
    try:
        for part, following in pairwise(path):
            missing = int(part) == len(data) if isinstance(data, list) else part not in data
            if missing and value is None:
                return False
            if isinstance(data, list):
                data += [{}] * missing
                data = data[int(part)]
            else:
                data = data.setdefault(part, [] if following.isdecimal() else {})
        if value is None and isinstance(data, dict):
            return data.pop(last, None) is not None
        data[int(last) if isinstance(data, list) else last] = value
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise JobError(f"{'.'.join(path)}: there is no such table to change ({error}); correct the key") from error
    return True


def _added(text: str, places: Mapping[Path, KeyPlace], path: Path, value: str) -> str:
    """The text with a new key: after the last one of its table, below its header, or in a new table at the end."""
    table = path[:-1]
    beside = [place for other, place in places.items() if other[:-1] == table and place.value is not None]
    if beside:
        last = max(beside, key=lambda place: place.end)
        return _below(text, last.end, f"{_key(path[len(last.table) :])} = {value}")
    if table in places:
        return _below(text, places[table].end, f"{_key(path[-1:])} = {value}")
    if not table:
        return f"{_key(path)} = {value}\n{text}"
    gap = "" if not text or text.endswith("\n\n") else "\n" if text.endswith("\n") else "\n\n"
    header = f"[[{_key(table[:-1])}]]" if table[-1].isdecimal() else f"[{_key(table)}]"
    return f"{text}{gap}{header}\n{_key(path[-1:])} = {value}\n"


def _below(text: str, end: int, line: str) -> str:
    """The text with a line below the one that contains ``end``."""
    after = text.find("\n", end)
    return f"{text}\n{line}\n" if after < 0 else f"{text[: after + 1]}{line}\n{text[after + 1 :]}"


def _without(text: str, places: Mapping[Path, KeyPlace], path: Path) -> str:
    """The text without the lines of a key, or of a table and the tables in it."""
    lines = [place for other, place in places.items() if other[: len(path)] == path]
    for place in sorted(lines, key=lambda place: -place.start):
        first, after = text.rfind("\n", 0, place.start) + 1, text.find("\n", place.end)
        text = text[:first] + ("" if after < 0 else text[after + 1 :])
    return text


def _key(parts: Path) -> str:
    return ".".join(map(bare, parts))
