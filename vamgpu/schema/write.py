"""A component as plain values that read back to an equal component."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from math import isfinite
from typing import Any, get_args, get_origin

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.schema.noun import fields_of, given, quantity_in
from vamgpu.schema.registry import family, name_of

LONGEST = 100_000  # largest number of values in a list of a manifest; longer lists belong in a file
ARRAY = "array"  # the key that names an array stored beside a description


def write(noun: Any, *, units: bool = False, arrays: dict[str, np.ndarray] | None = None) -> dict[str, Any]:
    """The kind and the fields of a component, with those of its components.

    Args:
        noun: A component whose class is registered.
        units: Write text with units, as in job files, in place of numbers in mm, s, mJ and rad.
        arrays: Receives the arrays [...], under names that replace them in the description; None rejects arrays.

    Returns:
        The table.

    Raises:
        BadInput: Only Python can describe it: a function, an array that is not stored, an unknown class.
    """
    name = name_of(type(noun))
    if name is None:
        cls = f"{type(noun).__module__}.{type(noun).__qualname__}"
        raise BadInput(f"nothing describes {_said(noun)}: {cls} is not a registered component; use "
                       "vamgpu.schema.register")  # fmt: skip
    values = given(noun)
    table: dict[str, Any] = {} if family(name[0]).default == name[1] else {"kind": name[1]}
    for field in fields_of(type(noun)):
        value = values.get(field.name, field.default)
        if isinstance(value, (int, float)) and not isfinite(value) and value == field.default:
            continue
        if units and value is None:
            continue  # TOML has no null
        table[field.name] = _plain(value, field.kind, f"{type(noun).__name__} {field.name}", units, arrays)
    return table


def _plain(value: Any, kind: Any, name: str, units: bool, arrays: dict[str, np.ndarray] | None) -> Any:
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, float, np.integer, np.floating)):
        if not isfinite(value):
            raise BadInput(f"{name} is {value!r}; a description holds only finite numbers")
        number = int(value) if isinstance(value, (int, np.integer)) else float(value)
        quantity = quantity_in(kind) if units else None
        return number if quantity is None else quantity.spell(number)
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.ndim < 2 and value.size <= LONGEST:
        return _plain(value.tolist(), kind, name, units, arrays)
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and arrays is not None:
        return {ARRAY: _kept(value, name.rpartition(" ")[2], arrays)}
    if isinstance(value, (tuple, list)):
        inner = zip(value, _elements(kind, len(value)), strict=True)
        return [_plain(item, part, f"{name}[{k}]", units, arrays) for k, (item, part) in enumerate(inner)]
    if callable(value) and name_of(type(value)) is None or isinstance(value, np.ndarray):
        raise BadInput(f"{name} is {_said(value)}, which no file can hold; give numbers, or store it in a file")
    return write(value, units=units, arrays=arrays)


def _kept(value: np.ndarray, name: str, arrays: dict[str, np.ndarray]) -> str:
    """The name under which an array is stored; equal arrays share one name."""
    known = next((key for key, other in arrays.items() if other is value), None)
    if known is None:
        known = next(key for k in count(1) if (key := f"{name}_{k}") not in arrays)
        arrays[known] = value
    return known


def _elements(kind: Any, count: int) -> list[Any]:
    """The types of a list's elements, as far as the field's type gives them."""
    for part in (kind, *get_args(kind)):
        parts = get_args(part)
        if get_origin(part) is Sequence or (get_origin(part) is tuple and parts[-1] is Ellipsis):
            return [parts[0]] * count
        if get_origin(part) is tuple:
            return list(parts)
    return [Any] * count


def _said(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array {value.shape}"
    return f"the function {value.__qualname__}" if hasattr(value, "__qualname__") else repr(value)[:120]
