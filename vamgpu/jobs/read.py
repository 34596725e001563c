"""Read a job file; report the line of every invalid value, the value, what was expected and the remedy."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

from pydantic import BaseModel, ValidationError

from vamgpu.deprecated import Renamed
from vamgpu.errors import JobError, WrongKey
from vamgpu.jobs.lines import key_lines, line_of
from vamgpu.jobs.model import JobFile
from vamgpu.schema.read import complaint, key_in_words, model_in, nouns_in
from vamgpu.schema.registry import name_of, nearest_of
from vamgpu.storage import reading
from vamgpu.storage.reading import parse_toml

MOST_REPORTED = 100  # number of invalid values of a file that one message lists

KINDS = {"rig": "a rig", "target": "a job"}  # table by which a file of another kind is known → its kind
AT_LINE = re.compile(r"at line (\d+)")  # place of an error in a message of the TOML parser

File = TypeVar("File", bound=BaseModel)


@dataclass(frozen=True)
class CheckedJob(Generic[File]):
    """A checked job. given: its keys as written, after ``--set``. folder: base of its relative paths."""

    file: File
    given: dict[str, Any]
    folder: Path
    name: str
    wanted: ClassVar[Renamed] = Renamed("file")
    model: ClassVar[type[BaseModel]]

    @classmethod
    def read(cls, path: str | Path, settings: Iterable[str] = ()) -> Self:
        """Read a TOML job file. Raises `JobError`."""
        place = Path(path)
        return cls.parse(read_text(place), settings, source=str(path), folder=place.parent, name=place.stem, files=True)

    @classmethod
    def parse(
        cls, text: str, settings: Iterable[str] = (), *, source: str = "job", folder: Path = Path(), name: str = "job",
        files: bool = False,
    ) -> Self:  # fmt: skip
        """A job from TOML text. files: whether named files must exist. Raises `JobError` with every invalid key."""
        file: Any
        file, given = checked(cls.model, text, settings, source=source, folder=folder, files=files)
        return cls(file, given, folder, name)

    @classmethod
    def of(
        cls, tables: dict[str, Any], settings: Iterable[str] = (), *, folder: Path = Path(), name: str = "job"
    ) -> Self:
        """A job from tables in the form of TOML; arguments and errors as for `parse`."""
        file: Any
        file, given = validated(cls.model, tables, settings, source=name, folder=folder)
        return cls(file, given, folder, name)


class Job(CheckedJob[JobFile]):
    """A checked job of a vessel that turns."""

    model: ClassVar[type[JobFile]] = JobFile


NOT_TEXT = "it is not text (a job file names a mesh in [target], or slices in [slices])"


def read_text(path: str | Path) -> str:
    """The text of a job file. Raises `JobError`."""
    try:
        return reading.read_text(path, reading.MOST_TOML)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or NOT_TEXT
        raise JobError(f"cannot read job file {str(path)!r}: {reason}; expected a TOML file: check the path, or let "
                       "`vam init` write one") from error  # fmt: skip


def checked(
    model: type[File], text: str, settings: Iterable[str] = (), *, source: str = "job", folder: Path = Path(),
    files: bool = False, complete: Callable[[dict[str, Any]], None] | None = None,
) -> tuple[File, dict[str, Any]]:  # fmt: skip
    """TOML text as a model of a file, and its keys as written; ``folder`` is the base of its relative paths."""
    data = checked_toml(text, source)
    return validated(model, data, settings, text=text, source=source, folder=folder, files=files, complete=complete)


def checked_toml(text: str, source: str = "job") -> dict[str, Any]:
    """The tables of a TOML text. Raises `JobError`."""
    try:
        return parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        found = AT_LINE.search(str(error))
        remedy = "correct that line" if Path(source).suffix.lower() in ("", ".toml") else "expected a TOML file"
        wrong = WrongKey("", int(found[1]) if found else None, f"not valid TOML: {error}; {remedy}")
        raise JobError(f"{source}: {wrong.message}", (wrong,)) from error


def validated(
    model: type[File], data: dict[str, Any], settings: Iterable[str] = (), *, text: str = "", source: str = "job",
    folder: Path = Path(), files: bool = False,
    complete: Callable[[dict[str, Any]], None] | None = None,
) -> tuple[File, dict[str, Any]]:  # fmt: skip
    """Tables as a model of a file; arguments and errors as for `checked`; ``text`` yields their lines."""
    for table, what in KINDS.items():
        if table in data and table not in model.model_fields and model.model_config.get("extra") != "ignore":
            needs = " and ".join(f"[{name}]" for name in KINDS if name in model.model_fields)
            raise JobError(f"{source} is the file of {what}, with a table [{table}]; expected another file"
                           f"{needs and f', with {needs}'}: check the path")  # fmt: skip
    replaced = {_replace(data, setting, model) for setting in settings}
    if complete is not None:
        complete(data)
    try:
        return model.model_validate(data, context={"folder": folder, "files": files}), data
    except ValidationError as error:
        lines = key_lines(text)
        raised = error.errors()
        every = [entry for entry in raised if not _misspelled(entry, raised)]
        found = [_complaint(entry, source, lines, replaced, model, data) for entry in every[:MOST_REPORTED]]
        said = [f"{place}: {wrong.message}" for place, wrong in found]
        said += [f"{source}: {len(every) - MOST_REPORTED} more invalid values"] if len(every) > MOST_REPORTED else []
        raise JobError("\n".join(said), (wrong for _, wrong in found)) from error


def _misspelled(entry: Any, others: Iterable[Any]) -> bool:
    """Whether a missing key is there under a similar name; the error of that name then suggests it."""
    *table, name = entry["loc"] or [""]
    return entry["type"] == "missing" and any(
        other["type"] == "extra_forbidden" and list(other["loc"][:-1]) == table
        and nearest_of(other["loc"][-1], [str(name)]) for other in others
    )  # fmt: skip


def _replace(data: dict[str, Any], setting: str, model: type[BaseModel]) -> tuple[str, ...]:
    """Put ``key=value`` into the data; the value is TOML (``false`` is false) or else plain text; none removes it."""
    dotted, separator, text = setting.partition("=")
    key = tuple(part.strip() for part in dotted.split("."))
    if not separator or not all(key):
        raise JobError(f"--set {setting}: expected key=value, such as --set solve.iterations=20")
    table, value = data, text.strip()
    for part in key[:-1]:
        table = table.setdefault(part, {}) if value else table.get(part, {})
        if not isinstance(table, dict):
            raise JobError(f"--set {setting}: {part!r} is {table!r}, not a table; name a key of the job file")
    if value:
        table[key[-1]] = toml_value(value)
    elif table.pop(key[-1], None) is None and key[-1] not in list(_models(key[:-1], model, data))[-1][0].model_fields:
        raise JobError(f"--set {setting}: removes a key that no such file has; leave it out, or correct the name")
    return key


def toml_value(text: str) -> Any:
    """A value as TOML reads it; text that is not a TOML value is not changed."""
    try:
        read = parse_toml(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return read["value"] if len(read) == 1 else text


def _complaint(
    entry: Any, source: str, lines: dict[tuple[str, ...], int], replaced: set[tuple[str, ...]], file: type[BaseModel],
    data: dict[str, Any],
) -> tuple[str, WrongKey]:  # fmt: skip
    """The place of an invalid value, and what is wrong with it."""
    between = getattr(entry.get("ctx", {}).get("error"), "key", ())
    parts = (*entry["loc"], *(int(part) if str(part).isdigit() else part for part in between))
    named = tuple(str(part) for part in parts if not isinstance(part, int))
    set_ = any(named[: len(changed)] == changed for changed in replaced)
    line = None if set_ else line_of(lines, _numbered(parts, named, lines))
    place = "--set" if set_ else f"{source}, line {line}" if line else source
    if entry["type"] == "missing" and isinstance(entry["input"], (list, tuple)) and isinstance(parts[-1], int):
        parts = parts[:-1]  # a missing value in a list has no name
    key, subject = ".".join(map(str, parts)) or "job", key_in_words(parts, data) or "job"
    if entry["type"] == "extra_forbidden":
        return place, WrongKey(key, line, f"{subject}: unknown key; {_spelling(named, file, data)}")
    return place, WrongKey(key, line, f"{subject}{complaint(entry, _remedy(parts, data))}")


def _numbered(key: tuple[Any, ...], named: tuple[str, ...], lines: Mapping[tuple[str, ...], int]) -> tuple[str, ...]:
    """A key as written, with the numbers of tables in the file."""
    found, words = (), iter(named)
    for part in key:
        if not isinstance(part, int):
            found = (*found, next(words))
        elif (*found, str(part)) in lines:
            found = (*found, str(part))
    return found


def _models(
    key: tuple[str, ...], file: type[BaseModel], data: dict[str, Any]
) -> Iterator[tuple[type[BaseModel], dict[str, Any]]]:
    """The model and the data of a file, and of each table along a key."""
    model = file
    yield model, data
    for part in key:
        field = model.model_fields.get(part)
        data = data.get(part, {}) if isinstance(data, dict) else {}
        model = model if field is None else model_in(field.annotation, field.metadata, data) or model
        yield model, data


def _spelling(key: tuple[str, ...], file: type[BaseModel], data: dict[str, Any]) -> str:
    *_, (model, table) = _models(key[:-1], file, data)
    known = list(model.model_fields)
    if others := _of_another_kind(key, file, data, table):
        return others
    close = nearest_of(key[-1], known)
    return f"did you mean {close!r}?" if close else f"expected one of {', '.join(known)}: correct or remove it"


def _of_another_kind(key: tuple[str, ...], file: type[BaseModel], data: dict[str, Any], table: Any) -> str:
    """Components allowed in a table that have a key which the table's own component lacks; empty if there are none."""
    if len(key) < 2:
        return ""
    *_, (within, _) = _models(key[:-2], file, data)
    field = within.model_fields.get(key[-2])
    nouns = None if field is None else nouns_in(field.annotation, field.metadata)
    if nouns is None or not isinstance(table, dict) or not (kinds := nouns.having(key[-1])):
        return ""
    _, own = name_of(nouns.chosen(table)) or ("", "")
    is_ = "is" if nouns.word in table else f"without a {nouns.word} is"
    others = " or ".join(f'{nouns.word} = "{kind}"' for kind in kinds)
    return f'it is one of {others}, and this table {is_} "{own}"; set the {nouns.word}, or remove the key'


def _remedy(key: tuple[Any, ...], data: dict[str, Any]) -> str:
    if not key:
        return "add it"
    table = key_in_words(key[:-1], data)
    within = table if table.startswith("[[") else f"[{table}]"
    return f"add {key[-1]} = … to {within}" if table else f"add the table [{key[0]}]"


read_job: Callable[..., Job] = Job.read
