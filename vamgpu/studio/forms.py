"""The keys of job files in a form that a page can draw: type, unit, bounds, default and meaning of each."""

from __future__ import annotations

from functools import cache
from math import isfinite
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from vamgpu.jobs.keys import FILES
from vamgpu.quantity import SPELLINGS
from vamgpu.schema.explain import Key, first_of, keys, kinds_of, what
from vamgpu.schema.noun import quantity_in
from vamgpu.schema.quantities import Quantity
from vamgpu.schema.read import Nouns, OneOrMany, nouns_in
from vamgpu.schema.registry import families, find
from vamgpu.schema.section import Named
from vamgpu.units import NAMES

WORDS: dict[Any, str] = {str: "text", int: "count", float: "number", bool: "bool"}


@cache
def form(kind: str = "vial") -> dict[str, Any]:
    """Tables of the files of a kind of job, and the components that tables may hold."""
    components = {f"{family}.{kind}": _component(find(family, kind)) for family, members in families().items()
                  for kind in members.nouns if not family.startswith("rig_")}  # fmt: skip
    return {
        "tables": [_table(name, field) for name, field in FILES[kind].model_fields.items()],
        "components": components,
    }


def _component(cls: type[Any]) -> dict[str, Any]:
    return {"doc": first_of(cls), "keys": _keys(cls)}


def _table(name: str, field: Any) -> dict[str, Any]:
    kind, nouns = field.annotation, nouns_in(field.annotation, field.metadata)
    choices = [f"{family}.{one}" for family, one in nouns.choices] if nouns else []
    section = next((part for part in _parts(kind) if isinstance(part, type) and issubclass(part, BaseModel)), None)
    head = {"name": name, "optional": not field.is_required(), "many": get_origin(kind) is tuple,
            "word": nouns.word if nouns else "", "component": choices[0] if len(choices) == 1 else None,
            "kinds": choices if len(choices) > 1 else [], "doc": "", "keys": []}  # fmt: skip
    if section is not None and nouns is None:
        return head | {"doc": first_of(section), "keys": _keys(section)}
    if head["component"]:
        component = _component(find(*choices[0].split(".", 1)))
        return head | component | {"keys": [*component["keys"], *_keys(nouns.others() if nouns else BaseModel)]}
    return head | {"doc": what(Annotated[kind, nouns]) if nouns else ""}


def _keys(table: type[Any]) -> list[dict[str, Any]]:
    kinds = kinds_of(table)
    return [_key(key, kinds[key.name]) for key in keys(table)]


def _key(key: Key, kind: Any) -> dict[str, Any]:
    quantity = quantity_in(kind)
    bounds = {name: None for name in ("least", "above", "most", "below")}
    shown = "" if quantity is None else quantity.example.rpartition(" ")[2] or quantity.unit  # pixels are typed in µm
    if quantity is not None:
        unit = quantity.scale / NAMES[shown] if shown else 1.0
        bounds = {name: limit * unit if isfinite(limit := getattr(quantity, name)) else None for name in bounds}
    literal = next((part for part in _parts(kind) if get_origin(part) is Literal), None)
    return {"name": key.name, "type": _type(kind, quantity, literal), "what": key.what, "doc": key.doc,
            "unit": shown, "required": not key.default,
            "units": list(SPELLINGS[quantity.kind]) if quantity and quantity.kind else [],
            "choices": list(get_args(literal)), "default": key.default.replace("left out", ""), **bounds}  # fmt: skip


def _type(kind: Any, quantity: Quantity | None, literal: Any) -> str:
    found = [WORDS[part] for part in _parts(kind) if part in WORDS]
    if Named in _marks(kind) and found == ["text"]:
        return "file"
    if quantity is not None:
        return "quantity" if quantity.kind else "count" if quantity.whole else "number"
    if literal is not None and not found:
        return "choice"
    if any(isinstance(mark, (Nouns, OneOrMany)) for mark in _marks(kind)):
        return "table" if any(isinstance(mark, Nouns) for mark in _marks(kind)) else "any"
    if any(get_origin(part) is tuple for part in _parts(kind)):
        return "list"
    return found[0] if len(set(found)) == 1 else "any"


def _parts(kind: Any) -> list[Any]:
    """The members of a union, without None and without marks."""
    if get_origin(kind) is Annotated:
        return _parts(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return [part for one in get_args(kind) for part in _parts(one)]
    if get_origin(kind) is tuple:
        return [kind, *_parts(get_args(kind)[0])]
    return [] if kind is NoneType else [kind]


def _marks(kind: Any) -> list[Any]:
    """The marks of a type and of the members of its union."""
    if get_origin(kind) is Annotated:
        return [*kind.__metadata__, *_marks(get_args(kind)[0])]
    return [mark for one in get_args(kind) for mark in _marks(one)] if get_origin(kind) in (Union, UnionType) else []
