"""Read a job file, and say of every wrong value where it stands, what it is, what was wanted and what to do."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from vamgpu.errors import JobError
from vamgpu.jobs.lines import key_lines, line_of
from vamgpu.jobs.model import JobFile


@dataclass(frozen=True)
class Job:
    """A checked job. given: its keys as written, ``--set`` included.  folder: what its paths are relative to."""

    wanted: JobFile
    given: dict[str, Any]
    folder: Path
    name: str


Wanted = TypeVar("Wanted", bound=BaseModel)


def read_job(path: str | Path, settings: Iterable[str] = ()) -> Job:
    """Read a TOML job file; ``settings`` are ``key=value`` that replace its values. Raises `JobError`."""
    file = Path(path)
    return parse_job(read_text(path), settings, source=str(path), folder=file.parent, name=file.stem)


def read_text(path: str | Path) -> str:
    """The text of a job file. Raises `JobError`."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise JobError(f"cannot read job file {str(path)!r}: {reason}; wanted a TOML file: check the path") from error


def parse_job(
    text: str, settings: Iterable[str] = (), *, source: str = "job", folder: Path = Path(), name: str = "job"
) -> Job:
    """A job from TOML text. Raises `JobError` naming every wrong value at once."""
    return Job(*checked(JobFile, text, settings, source=source), folder, name)


def checked(
    model: type[Wanted], text: str, settings: Iterable[str] = (), *, source: str = "job"
) -> tuple[Wanted, dict[str, Any]]:
    """TOML text as a model of a file, and its keys as written. Raises `JobError` naming every wrong value at once."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise JobError(f"{source}: not valid TOML: {error}; correct that line") from error
    replaced = {_replace(data, setting) for setting in settings}
    try:
        return model.model_validate(data), data
    except ValidationError as error:
        lines = key_lines(text)
        found = [_complaint(entry, source, lines, replaced, model) for entry in error.errors()]
        raise JobError("\n".join(found)) from error


def _replace(data: dict[str, Any], setting: str) -> tuple[str, ...]:
    """Put ``key=value`` into the data; the value is TOML (so ``false`` is false), else plain text."""
    dotted, separator, text = setting.partition("=")
    key = tuple(part.strip() for part in dotted.split("."))
    if not separator or not all(key):
        raise JobError(f"--set {setting}: wanted key=value, such as --set solve.iterations=20")
    table: Any = data
    for part in key[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise JobError(f"--set {setting}: {part!r} is {table!r}, no table; name a key of the job file")
    table[key[-1]] = toml_value(text.strip())
    return key


def toml_value(text: str) -> Any:
    """A value as TOML reads it; text that is no TOML value is taken as it stands."""
    try:
        read = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return read["value"] if len(read) == 1 else text


def _complaint(
    entry: Any, source: str, lines: dict[tuple[str, ...], int], replaced: set[tuple[str, ...]], file: type[BaseModel]
) -> str:
    between = getattr(entry.get("ctx", {}).get("error"), "key", ())
    key = tuple(str(part) for part in (*entry["loc"], *between))
    named = tuple(part for part in key if not part.isdigit())
    if any(named[: len(changed)] == changed for changed in replaced):
        place = "--set"
    else:
        line = line_of(lines, named)
        place = f"{source}, line {line}" if line else source
    subject = ".".join(key) or "job"
    if entry["type"] == "extra_forbidden":
        return f"{place}: {subject}: unknown key; {_spelling(key, file)}"
    if entry["type"] == "missing":
        return f"{place}: {subject} is missing; {_remedy(key)}"
    got = "" if isinstance(entry["input"], dict | BaseModel) else f" got {entry['input']!r};"
    said = entry["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    wanted = said if entry["type"] == "value_error" else f"wanted {said}; correct the value"
    return f"{place}: {subject}:{got} {wanted}"


def _model_at(key: tuple[str, ...], file: type[BaseModel]) -> type[BaseModel]:
    """The section that a key's parent names."""
    model = file
    for part in key[:-1]:
        annotation = model.model_fields[part].annotation if part in model.model_fields else None
        choices = [annotation, *get_args(annotation)]
        model = next((c for c in choices if isinstance(c, type) and issubclass(c, BaseModel)), model)
    return model


def _spelling(key: tuple[str, ...], file: type[BaseModel]) -> str:
    known = list(_model_at(key, file).model_fields)
    close = get_close_matches(key[-1], known, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"wanted one of {', '.join(known)}: correct or remove it"


def _remedy(key: tuple[str, ...]) -> str:
    return f"add the table [{key[0]}]" if len(key) == 1 else f"add {key[-1]} = … to [{'.'.join(key[:-1])}]"
