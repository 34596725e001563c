"""The keys of every job file, from the models that read them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from textwrap import wrap
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.jobs.curethrough import EXAMPLE, CurethroughFile
from vamgpu.jobs.cuvettes import CuvetteFile
from vamgpu.jobs.demo import JOB, WEB_JOB
from vamgpu.jobs.limits import MachineFile
from vamgpu.jobs.model import JobFile
from vamgpu.jobs.web import WebFile
from vamgpu.schema.explain import LEFT_OUT, NO_LIMIT, Key, explain, first_of, json_schema, keys, what
from vamgpu.schema.noun import docs_of
from vamgpu.schema.read import Nouns, model_in
from vamgpu.schema.registry import families, find
from vamgpu.schema.section import Listed
from vamgpu.storage.reading import parse_toml

FILES: dict[str, type[Any]] = {
    "vial": JobFile, "web": WebFile, "machine": MachineFile, "slices": CurethroughFile, "cuvettes": CuvetteFile
}  # fmt: skip
"""Kind of file → its model."""
EXAMPLES = {"vial": JOB, "web": WEB_JOB, "machine": WEB_JOB, "slices": EXAMPLE}  # kind of file → a valid example
BARE = re.compile(r"[A-Za-z0-9_-]+")  # keys without quotes
HEADS = {
    "vial": "Jobs of a vial or another vessel that turns",
    "web": "Jobs of an endless web",
    "machine": "Machines of a web, for `vam limits`",
    "slices": "Jobs of cure-through",
    "cuvettes": "Readings for `vam calibrate scatter`",
}


def reference() -> str:
    """The list of all keys, as Markdown."""
    head = (
        "# Keys of job files\n\n"
        "Written by `vam keys`, which reads the library's own definitions. Quantities are text with a unit, such as\n"
        '`"12.4 mm"`; Python and manifests use the unit shown. `--set table.key=value` replaces a value on the\n'
        "command line, and `vam schema` writes a JSON Schema for editors.\n"
    )
    return f"{head}\n{explain({HEADS[name]: file for name, file in FILES.items()})}"


def keys_of(name: str) -> tuple[Key, ...]:
    """List the keys of one table. Raises `BadInput`."""
    first, _, second = name.partition(".")
    if first in families() and second:
        return keys(find(first, second))
    files = {first: FILES[first]} if second and first in FILES else FILES
    for file in files.values():
        field = file.model_fields.get(second or first)
        model = None if field is None else model_in(field.annotation, field.metadata)
        if model is not None:
            return keys(model)
    if first in families():
        nouns = ", ".join(f"{first}.{kind}" for kind in families()[first].nouns)
        raise BadInput(f"{first} is a family; expected one of {nouns}")
    tables = dict.fromkeys(table for file in FILES.values() for table in file.model_fields)
    raise BadInput(f"no table {name!r}; expected one of {', '.join(tables)}, or a component such as vessel.fan")


def schema_of(name: str) -> dict[str, Any]:
    """Write the JSON Schema of a file. Raises `BadInput`."""
    if name not in FILES:
        raise BadInput(f"no file {name!r}; expected one of {', '.join(FILES)}")
    return json_schema(FILES[name])


def commented(name: str) -> str:
    """Write a job file that can be solved at once, with every other key and its meaning in comments."""
    if name not in EXAMPLES:
        raise BadInput(f"no file {name!r}; expected one of {', '.join(EXAMPLES)}")
    given, file = parse_toml(EXAMPLES[name]), FILES[name]
    lines = _remark(f"{HEADS[name]}, written by `vam init`. Keys behind # are left out and show their default; `vam "
                    "keys` explains all keys.")  # fmt: skip
    for table, field in file.model_fields.items():
        values = given.get(table)
        model = model_in(field.annotation, field.metadata, values or {})
        off = "# " if values is None else ""
        doc = docs_of(file, [table]).get(table, "") if model is None else first_of(model)
        lines += ["", *_remark(doc or what(field.annotation))]
        head = f"[[{table}]]" if Listed in field.metadata else f"[{table}]"  # several tables, such as bodies
        lines.append(off + head + ("" if model is not None else f"  # {_kinds(field)}"))
        for key in () if model is None else keys(model):
            lines += _remark(f"{key.doc or key.name}: {key.what}" if key.what else key.doc or key.name)
            known = values is not None and key.name in values
            usual = "…" if key.default in ("", LEFT_OUT, NO_LIMIT) else key.default
            value = toml_of(values[key.name]) if known and values is not None else usual
            lines.append(f"{off if known else '# '}{key.name} = {value}")
    return "\n".join(lines) + "\n"


def _remark(text: str) -> list[str]:
    return [f"# {line}" for line in wrap(text, 116)]


def _kinds(field: Any) -> str:
    """Reference to the components that a table may hold."""
    nouns = next((part for part in field.metadata if isinstance(part, Nouns)), None)
    names = [] if nouns is None else [f"{family}.{kind}" for family, kind in nouns.choices]
    return f"kind = …; see vam keys {names[0]}" if names else "see vam keys"


def bare(key: str) -> str:
    """A key in TOML, in quotes if it needs them."""
    return key if BARE.fullmatch(key) else json.dumps(key, ensure_ascii=False)


def toml_of(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{bare(key)} = {toml_of(part)}" for key, part in value.items()) + " }"
    return f"[{', '.join(map(toml_of, value))}]" if isinstance(value, list) else json.dumps(value, ensure_ascii=False)


def toml_text(tables: Mapping[str, Any]) -> str:
    """Write tables as a TOML file."""
    lines: list[str] = []
    for name, table in tables.items():
        for one in table if isinstance(table, list) else [table]:
            head = f"[[{name}]]" if isinstance(table, list) else f"[{name}]"
            lines += [head, *(f"{key} = {toml_of(value)}" for key, value in one.items()), ""]
    return "\n".join(lines)


def explained(name: str) -> tuple[Key, ...]:
    """List the keys of a table or a component, the components of a family, or one key."""
    name = name.removeprefix("any ")  # the list of keys says "any vessel"
    try:
        return keys_of(name)
    except BadInput as error:
        wrong, (table, _, last) = error, name.rpartition(".")
        if name in families():
            usual = families()[name].default
            nouns = ((kind, "the default" if kind == usual else "–") for kind in families()[name].nouns)
            return tuple(Key(f"{name}.{kind}", "a table", how, first_of(find(name, kind))) for kind, how in nouns)
        with suppress(BadInput):
            known = {key.name: key for key in keys_of(table)}
            if last in known:
                return (known[last],)
            wrong = BadInput(f"no key {last!r} in {table}; expected one of {', '.join(known)}: correct the name")
        raise wrong from None
