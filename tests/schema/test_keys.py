"""The list of keys and the schema for editors say what the readers of files do."""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any

import pytest
from web_machine import MACHINE

from vamgpu.cli import main
from vamgpu.errors import BadInput
from vamgpu.jobs.curethrough import EXAMPLE
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.demo import WEB_JOB as WEB
from vamgpu.jobs.keys import FILES, HEADS, keys_of, reference, schema_of
from vamgpu.schema.explain import keys
from vamgpu.schema.registry import families, find


def test_the_page_of_keys_has_every_table_with_its_keys(capsys: pytest.CaptureFixture[str]) -> None:
    page = reference()
    assert main(["keys"]) == 0 and capsys.readouterr().out.strip() == page.strip()
    for name, file in FILES.items():
        assert f"\n## {HEADS[name]}\n" in page
        tables = [table for table in file.model_fields if f"[{table}]" in page]
        assert tables == list(file.model_fields)
    assert all(f"| `{key.name}` |" in page for key in keys_of("beam"))


def test_every_table_of_every_file_can_be_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    for name, file in FILES.items():
        for table in set(file.model_fields) - {"vessel", "light"}:
            assert keys_of(f"{name}.{table}"), table
    assert main(["keys", "lens.tunable"]) == 0
    assert '["5 dpt", "10 dpt"]' in capsys.readouterr().out
    with pytest.raises(BadInput, match="expected one of vessel.vial, vessel.vat"):
        keys_of("vessel")
    with pytest.raises(BadInput, match="no table 'beem'"):
        keys_of("beem")


def test_keys_of_files_say_what_they_mean() -> None:
    for name, file in FILES.items():
        for table in set(file.model_fields) - {"vessel", "light", "method"}:
            silent = [key.name for key in keys_of(f"{name}.{table}") if not key.doc]
            assert not silent, (name, table)
    for name, members in families().items():
        for kind in members.nouns:
            docs = {key.name: key.doc for key in keys(find(name, kind))}
            assert not [key for key, doc in docs.items() if not doc or re.search(r"\.\s+[a-z_]+: ", doc)], kind


def wrong(schema: dict[str, Any], value: Any, root: dict[str, Any]) -> str:
    """Why a value does not obey a schema, by as much of the language as these schemas speak; "" where it does."""
    if "$ref" in schema:
        return wrong(root["$defs"][schema["$ref"].removeprefix("#/$defs/")], value, root)
    if "anyOf" in schema:
        found = [wrong(part, value, root) for part in schema["anyOf"]]
        return "" if "" in found else min(found, key=len)
    if "allOf" in schema:
        return next((said for part in schema["allOf"] if (said := wrong(part, value, root))), "")
    if "const" in schema and value != schema["const"]:
        return f"{value} is not {schema['const']}"
    if "enum" in schema and value not in schema["enum"]:
        return f"{value} is not in {schema['enum']}"
    kinds = {"string": str, "integer": int, "number": (int, float), "boolean": bool, "array": list, "object": dict}
    if "type" in schema and not isinstance(value, kinds[schema["type"]]):
        return f"{value} is no {schema['type']}"
    if isinstance(value, dict):
        known = schema.get("properties", {})
        if missing := set(schema.get("required", ())) - set(value):
            return f"{missing} missing"
        if schema.get("additionalProperties") is False and (odd := set(value) - set(known)):
            return f"{odd} unknown"
        return next((said for key in value if key in known and (said := wrong(known[key], value[key], root))), "")
    return ""


FAN = """
[vessel]
kind = "fan"
throw = "300 mm"
[vessel.vessel]
kind = "vial"
radius = "12.4 mm"
wall = "1 mm"
resin_index = 1.5
wall_index = 1.47
"""


HEAD = JOB[: JOB.index("[vial]")]
WRONG = (("throw =", "trow ="), ('"fan"', '"fna"'), ('"12.4 mm"', "12.4"), ("wall = ", "#"), ('kind = "vial"', ""))


@pytest.mark.parametrize(
    ("name", "text"),
    [("vial", JOB), ("vial", HEAD + FAN), ("web", WEB), ("machine", MACHINE), ("slices", EXAMPLE)],
)
def test_files_obey_their_schema(name: str, text: str) -> None:
    schema = json.loads(json.dumps(schema_of(name), allow_nan=False))
    assert wrong(schema, tomllib.loads(text), schema) == ""


def test_the_schema_refuses_what_the_reader_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "vial"]) == 0
    schema = json.loads(capsys.readouterr().out)
    for old, new in WRONG:
        assert wrong(schema, tomllib.loads(HEAD + FAN.replace(old, new)), schema), new


def test_keys_beside_those_of_a_component_are_listed_at_its_table() -> None:
    table = reference().split("### [scattering]")[1].split("###")[0]
    assert "| `photons` | a whole number ≥ 1 | `4194304` |" in table and "| `tolerance` |" in table
