"""List the keys of files, their values and their meanings; also as a JSON Schema for editors."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel

from vamgpu.schema.noun import MISSING, docs_of, fields_of, quantity_in
from vamgpu.schema.quantities import Quantity
from vamgpu.schema.read import NOUN, Kept, Nouns, OneOrMany, in_files, model_of, nouns_in
from vamgpu.schema.registry import families, family, find
from vamgpu.schema.write import write
from vamgpu.units import NAMES

LEFT_OUT = "left out"
NO_LIMIT = "no limit"
FAR = 1e30  # numbers of at least this size mean infinity; no device handles them
WORDS: dict[Any, str] = {str: "text", int: "a whole number", float: "a number", bool: "true or false"}


@dataclass(frozen=True)
class Key:
    """One key of a table. what: its values. default: as in a file; "" if the key is required. doc: its meaning."""

    name: str
    what: str
    default: str
    doc: str


def keys(table: type[Any]) -> tuple[Key, ...]:
    """The keys that files may write for a component or a `Section`."""
    return tuple(Key(name, what(kind), _default(default, kind), doc) for name, kind, default, doc in _raw(table))


def kinds_of(table: type[Any]) -> dict[str, Any]:
    """The types of those keys."""
    return {name: kind for name, kind, _, _ in _raw(table)}


def _raw(table: type[Any]) -> list[tuple[str, Any, Any, str]]:
    """Name, type, default and meaning of keys."""
    if issubclass(table, BaseModel):
        hints, fields = get_type_hints(table, include_extras=True), table.model_fields
        docs = docs_of(table, list(fields))
        return [
            (name, hints[name], MISSING if info.is_required() else info.default, info.description or docs.get(name, ""))
            for name, info in fields.items()
        ]
    written = {
        name
        for name, info in model_of(table).model_fields.items()
        if info.annotation is not NoneType and not any(isinstance(mark, Kept) for mark in info.metadata)
    }
    return [(field.name, field.kind, field.default, field.doc) for field in fields_of(table) if field.name in written]


def what(kind: Any) -> str:
    """Description of a key's values."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        for mark in kind.__metadata__:
            if isinstance(mark, Quantity):
                named = mark.kind or ("a whole number" if mark.whole else "a number")
                return f"{named}{f' {mark.bounds}' if mark.bounds else ''}{f' {mark.unit}' if mark.unit else ''}"
            if isinstance(mark, Nouns):
                return _choices(mark)
            if isinstance(mark, OneOrMany):
                return f"{what(mark.one)}, or a list of them"
        return what(parts[0])
    if origin in (Union, UnionType):
        said = [what(part) for part in parts if part is not NoneType]
        return " or ".join(dict.fromkeys(part for part in said if part))
    if origin is Literal:
        return " or ".join(f'"{value}"' if isinstance(value, str) else str(value) for value in parts)
    if origin is tuple or str(origin).endswith("Sequence'>"):
        inner = list(dict.fromkeys(what(part) for part in parts if part is not Ellipsis))
        count = f" of {len(parts)}" if origin is tuple and parts[-1] is not Ellipsis else ""
        return f"a list{count}, each {inner[0]}" if len(inner) == 1 else f"a list{count}: {'; '.join(inner)}"
    if isinstance(kind, type) and kind not in WORDS:
        nouns = [mark for mark in getattr(in_files(kind), "__metadata__", ()) if isinstance(mark, Nouns)]
        return _choices(nouns[0]) if nouns else "a table" if issubclass(kind, BaseModel) else ""
    return WORDS.get(kind, "")


def _choices(nouns: Nouns) -> str:
    names = dict.fromkeys(name for name, _ in nouns.choices)
    if len(nouns.choices) == 1:
        name, kind = nouns.choices[0]
        return f"a table: {name}.{kind}"
    whole = all(set(family(name).nouns) == {kind for one, kind in nouns.choices if one == name} for name in names)
    listed = (f"any {name}" for name in names) if whole else (f"{name}.{kind}" for name, kind in nouns.choices)
    return f"a table: {' or '.join(listed)}"


def _default(value: Any, kind: Any) -> str:
    if value is MISSING:
        return ""
    if value is None or value == {} or isinstance(value, BaseModel) or isinstance(value, float) and not isfinite(value):
        return LEFT_OUT
    if isinstance(value, bool):
        return str(value).lower()
    kind = next((mark.one for mark in getattr(kind, "__metadata__", ()) if isinstance(mark, OneOrMany)), kind)
    if isinstance(value, (int, float)):
        quantity = quantity_in(kind)
        if quantity is None or quantity.kind is None:
            return str(value) if isinstance(value, int) else f"{value:g}"
        if abs(value) >= FAR:
            return NO_LIMIT
        return f'"{value * quantity.scale / NAMES[quantity.unit]:g} {quantity.unit}"'
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        inner = get_args(kind) if get_origin(kind) is tuple else ()
        parts = inner if len(inner) == len(value) else (Any,) * len(value)
        items = [_default(item, part) for item, part in zip(value, parts, strict=True)]
        return NO_LIMIT if items and set(items) == {NO_LIMIT} else f"[{', '.join(items)}]"
    table = write(value, units=True)
    return table.get("kind", "its defaults")


def explain(tables: dict[str, type[Any]]) -> str:
    """The keys of tables and of every component, as Markdown."""
    return "\n".join([*(part for head, file in tables.items() for part in _file(head, file)), *_nouns()]) + "\n"


def _file(head: str, file: type[Any]) -> Iterator[str]:
    yield f"## {head}\n"
    for name, hint in get_type_hints(file, include_extras=True).items():
        if name not in file.model_fields:
            continue
        listed = next((part for part in (hint, *get_args(hint)) if get_origin(part) is tuple), None)
        section = next((part for part in (hint, *get_args(listed or hint)) if isinstance(part, type)
                        and part is not NoneType and issubclass(part, BaseModel)), None)  # fmt: skip
        named = f"[[{name}]]" if listed and section else f"[{name}]"
        optional = "" if file.model_fields[name].is_required() else " (may be left out)"
        yield f"### {named}{optional}\n"
        yield f"{first_of(section)}\n" if section is not None else f"{what(hint).capitalize()}, see below.\n"
        nouns = nouns_in(file.model_fields[name].annotation, file.model_fields[name].metadata)
        section = section or (nouns.others() if nouns and nouns.beside else None)
        if section is not None:
            yield from _table(section)


def _nouns() -> Iterator[str]:
    yield "## Components\n"
    yield (
        "A component is a class that files name by its family and kind: `vessel.fan` is a table with\n"
        '`kind = "fan"` where a vessel is expected, such as [vessel]. The default one needs no `kind`.\n'
    )
    for name, members in families().items():
        for kind in members.nouns:
            cls = find(name, kind)
            usual = ", the default" if members.default == kind else ""
            yield f"### {name}.{kind}{usual}\n"
            yield f"{first_of(cls)}\n"
            yield from _table(cls)


def first_of(cls: type[Any]) -> str:
    """The first paragraph of a docstring, without the fields that follow in the same line."""
    text = " ".join((cls.__doc__ or "").strip().split("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[a-z_]+: )", text)[0]


def _table(table: type[Any]) -> Iterator[str]:
    found = keys(table)
    if not found:
        return
    yield "| key | holds | default | meaning |\n|---|---|---|---|"
    for key in found:
        usual = {"": "required", LEFT_OUT: LEFT_OUT, NO_LIMIT: NO_LIMIT}.get(key.default, f"`{key.default}`")
        cells = (f"`{key.name}`", key.what, usual, key.doc)
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
    yield ""


def json_schema(file: type[BaseModel]) -> dict[str, Any]:
    """The JSON Schema of a file, with every component of its tables, for editors that complete and check TOML."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # defaults that are components have no JSON
        schema = file.model_json_schema()
        defined = schema.setdefault("$defs", {})
        while missing := sorted(set(_nouns_in(schema)) - set(defined)):
            for ref in missing:
                name, _, kind = ref.partition(".")
                one = model_of(find(name, kind)).model_json_schema()
                defined |= one.pop("$defs", {})
                one.setdefault("properties", {})[family(name).word] = {"const": kind}
                defined[ref] = one
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_clean(schema)}


def _nouns_in(value: Any) -> Iterator[str]:
    if isinstance(value, dict) and isinstance(value.get(NOUN), str):
        yield value[NOUN]
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _nouns_in(part)


def _clean(value: Any) -> Any:
    """With references to components. It omits null, which TOML lacks, and defaults that a file writes differently."""
    if isinstance(value, list):
        return [_clean(part) for part in value if part != {"type": "null"}]
    if not isinstance(value, dict):
        return value
    if isinstance(value.get(NOUN), str):
        return {"$ref": f"#/$defs/{value[NOUN]}", **{key: part for key, part in value.items() if key == "description"}}
    default = value.get("default")
    measured = value.get("type") == "string" or {"type": "string"} in value.get("anyOf", ())
    odd = isinstance(default, (int, float)) and (not isfinite(default) or measured and not isinstance(default, str))
    dropped = {"default"} if default is None or odd else set()
    return {key: _clean(part) for key, part in value.items() if key not in dropped or key == "properties"}
