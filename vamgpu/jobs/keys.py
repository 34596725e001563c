"""The keys of every job file, from the models that read them."""

from __future__ import annotations

from typing import Any

from vamgpu.errors import BadInput
from vamgpu.jobs.curethrough import CurethroughFile
from vamgpu.jobs.limits import MachineFile
from vamgpu.jobs.model import JobFile
from vamgpu.jobs.web import WebFile
from vamgpu.schema.explain import Key, explain, json_schema, keys
from vamgpu.schema.read import model_in
from vamgpu.schema.registry import families, find

FILES: dict[str, type[Any]] = {"vial": JobFile, "web": WebFile, "machine": MachineFile, "slices": CurethroughFile}
"""What a file is for → its model."""
HEADS = {
    "vial": "Jobs of a vial or another vessel that turns",
    "web": "Jobs of an endless web",
    "machine": "Machines of a web, for `vam limits`",
    "slices": "Jobs of cure-through",
}


def reference() -> str:
    """The list of all keys, as markdown."""
    head = (
        "# Keys of job files\n\n"
        "Written by `vam keys`, which reads the library's own definitions. Quantities are text with a unit, such as\n"
        '`"12.4 mm"`; the unit shown is the one that Python and manifests count in. `--set table.key=value`\n'
        "replaces a value on the command line, and `vam schema` writes a JSON Schema for editors.\n"
    )
    return f"{head}\n{explain({HEADS[name]: file for name, file in FILES.items()})}"


def keys_of(name: str) -> tuple[Key, ...]:
    """The keys of one table: that of a file, such as "beam" or "web.beam", or a noun, such as "vessel.fan".

    Raises:
        BadInput: there is no such table.
    """
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
        raise BadInput(f"{first} is a family; wanted one of {nouns}")
    tables = dict.fromkeys(table for file in FILES.values() for table in file.model_fields)
    raise BadInput(f"no table {name!r}; wanted one of {', '.join(tables)}, or a noun such as vessel.fan")


def schema_of(name: str) -> dict[str, Any]:
    """The JSON Schema of a file; ``name`` is a key of `FILES`. Raises `BadInput`."""
    if name not in FILES:
        raise BadInput(f"no file {name!r}; wanted one of {', '.join(FILES)}")
    return json_schema(FILES[name])
