"""Read a job file, and say of every wrong value where it stands, what it is, what was wanted and what to do."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from vamgpu.errors import JobError
from vamgpu.jobs.lines import key_lines, line_of
from vamgpu.jobs.model import JobFile
from vamgpu.schema.read import complaint, model_in


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
    return Job(*checked(JobFile, text, settings, source=source, folder=folder), folder, name)


def checked(
    model: type[Wanted], text: str, settings: Iterable[str] = (), *, source: str = "job", folder: Path = Path()
) -> tuple[Wanted, dict[str, Any]]:
    """TOML text as a model of a file, and its keys as written; ``folder`` is what paths in it are relative to.

    Raises `JobError` naming every wrong value at once.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise JobError(f"{source}: not valid TOML: {error}; correct that line") from error
    replaced = {_replace(data, setting) for setting in settings}
    try:
        return model.model_validate(data, context={"folder": folder}), data
    except ValidationError as error:
        lines = key_lines(text)
        found = [_complaint(entry, source, lines, replaced, model, data) for entry in error.errors()]
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
    entry: Any, source: str, lines: dict[tuple[str, ...], int], replaced: set[tuple[str, ...]], file: type[BaseModel],
    data: dict[str, Any],
) -> str:  # fmt: skip
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
        return f"{place}: {subject}: unknown key; {_spelling(named, file, data)}"
    return f"{place}: {subject}{complaint(entry, _remedy(key))}"


def _spelling(key: tuple[str, ...], file: type[BaseModel], data: dict[str, Any]) -> str:
    model = file
    for part in key[:-1]:
        field = model.model_fields.get(part)
        data = data.get(part, {}) if isinstance(data, dict) else {}
        model = model if field is None else model_in(field.annotation, field.metadata, data) or model
    known = list(model.model_fields)
    close = get_close_matches(key[-1], known, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"wanted one of {', '.join(known)}: correct or remove it"


def _remedy(key: tuple[str, ...]) -> str:
    if not key:
        return "add it"
    return f"add the table [{key[0]}]" if len(key) == 1 else f"add {key[-1]} = … to [{'.'.join(key[:-1])}]"
