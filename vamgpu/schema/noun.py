"""Fields of a constructor, and the checks that follow from their types."""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.schema.quantities import Quantity, measured

GIVEN = ("device",)  # arguments that select the device, not the computation
MISSING: Any = inspect.Parameter.empty


@dataclass(frozen=True)
class Field:
    """One field of a component.

    Args:
        name: Its name.
        kind: Its type, with `Quantity` if it measures something.
        default: Its default; `MISSING` if it is required.
        doc: Its description in the docstring.
    """

    name: str
    kind: Any
    default: Any
    doc: str

    @property
    def required(self) -> bool:
        """Whether it has no default."""
        return self.default is MISSING

    @property
    def quantity(self) -> Quantity | None:
        """The quantity that it measures; None if it is not a number."""
        return quantity_in(self.kind)


@cache
def fields_of(cls: type[Any]) -> tuple[Field, ...]:
    """List the fields of a component.

    Args:
        cls: Its class.

    Returns:
        The fields, in the order of the constructor.
    """
    generated = getattr(getattr(cls, "__dataclass_params__", None), "init", False) or hasattr(cls, "model_fields")
    hints = get_type_hints(cls if generated else cls.__init__, include_extras=True)
    taken = [p for p in inspect.signature(cls).parameters.values() if p.name not in GIVEN and p.kind not in (
        inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)]  # fmt: skip
    docs = docs_of(cls, [*(p.name for p in taken), *GIVEN])
    return tuple(Field(p.name, hints.get(p.name, Any), p.default, docs.get(p.name, "")) for p in taken)


def given(noun: Any) -> dict[str, Any]:
    """Arguments of a component's constructor, by field."""
    if hasattr(noun, "described"):
        return noun.described()
    return {field.name: getattr(noun, field.name) for field in fields_of(type(noun))}


def docs_of(cls: type[Any], names: list[str]) -> dict[str, str]:
    """Descriptions of names in the docstrings of a class and its bases, under ``Args:`` or in a line."""
    found: dict[str, str] = {}
    name = "|".join(map(re.escape, names)) or "$."
    listed = rf"(?:^|\n|  |(?<=\.) )((?:{name})(?:, (?:{name}))*):\s+"
    entry = re.compile(rf"{listed}(.*?)(?={listed}|(?<=\.)\s+[a-z_]+:\s|\n\n|\.\s+(?:Raises|Sources?)\b|\Z)", re.DOTALL)
    for part in reversed(cls.__mro__):
        text = "\n".join(line.strip() for line in (part.__doc__ or "").splitlines())
        for match in entry.finditer(text):
            said = " ".join(match[2].split()).rstrip(".")
            for one in match[1].split(", "):
                if not (one in found and said.lower().startswith("as for")):
                    found[one] = said
    return found


def quantity_in(kind: Any) -> Quantity | None:
    """The quantity that a type measures, directly or in a union with None."""
    if get_origin(kind) is Annotated:
        return next((part for part in kind.__metadata__ if isinstance(part, Quantity)), None)
    if get_origin(kind) in (Union, UnionType):
        return next((found for part in get_args(kind) if (found := quantity_in(part))), None)
    return None


def check(noun: Any) -> None:
    """Check the fields of a frozen component by their types, and store them as floats.

    Args:
        noun: The component.

    Raises:
        BadInput: A value is out of its range.
    """
    cls = type(noun)
    for field in fields_of(cls):
        value = getattr(noun, field.name)
        checked = _checked(field.kind, f"{cls.__name__} {field.name}", value)
        if checked is not value:
            object.__setattr__(noun, field.name, checked)


def _checked(kind: Any, name: str, value: Any) -> Any:
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        quantity = quantity_in(kind)
        if quantity is None:
            return _checked(parts[0], name, value)
        return measured(name, value, kind)
    if origin in (Union, UnionType):
        quantities = [part for part in parts if quantity_in(part)]
        other = value is None and NoneType in parts or callable(value)
        other = other or isinstance(value, (list, tuple, np.ndarray)) and np.ndim(value) > 0
        return value if other or not quantities else _checked(quantities[0], name, value)
    if origin is tuple and any(quantity_in(part) for part in parts):
        if parts[-1] is Ellipsis:
            parts = parts[:1] * np.size(value)
        if not isinstance(value, (list, tuple, np.ndarray)) or len(value) != len(parts):
            raise BadInput(f"{name} is {value!r}; expected {len(parts)} numbers")
        return tuple(_checked(part, name, item) for part, item in zip(parts, value, strict=True))
    return value
