"""Descriptions of a web in plain values, for reading its frames and for recognizing the web."""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass, replace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.optics.index_field import FormulaField, GridField
from vamgpu.optics.roller_index import FilmIndex
from vamgpu.printing.focus import FocusMasks
from vamgpu.schema.read import read
from vamgpu.schema.write import write
from vamgpu.storage.folder import digest
from vamgpu.storage.reading import malformed
from vamgpu.targets.stream import Repeated
from vamgpu.web import Wrap

MOST_MEDIUM = 16_000_000
"""Largest size of a medium's arrays in a folder's record [bytes]; the record is rewritten with every segment."""


def described(value: Any) -> dict[str, Any]:
    """A frozen component as plain values: its kind and its fields."""
    fields = asdict(value) if is_dataclass(value) and not isinstance(value, type) else {}
    return {"kind": type(value).__name__, **{key: _simple(part) for key, part in fields.items()}}


def described_wrap(wrap: Wrap) -> dict[str, Any]:
    """A machine as plain values, the arrays of its medium included. Raises `BadInput` for a function."""
    index = getattr(wrap, "index", None)
    if not isinstance(index, FilmIndex):
        return described(wrap)
    if not isinstance(index.index, (FormulaField, GridField)):
        name = getattr(index.index, "__qualname__", type(index.index).__name__)
        raise BadInput(f"the index of the film is {name}, a function, which a folder cannot keep; expected a "
                       "FormulaField, or a GridField, such as FunctionField(function, region).sampled")  # fmt: skip
    arrays: dict[str, np.ndarray] = {}
    plain = {**described(replace(wrap, index=None)), "index": write(index, arrays=arrays)}  # type: ignore[type-var]
    if sum(values.nbytes for values in arrays.values()) > MOST_MEDIUM:
        raise BadInput(f"the index of the film is a {type(index.index).__name__} of {index.index.coefficients.shape}; "  # type: ignore[union-attr]
                       f"expected {MOST_MEDIUM} bytes at most, the limit of a folder: use coarser samples")  # fmt: skip
    kept = {name: {"shape": list(values.shape), "float64": b64encode(np.asarray(values, "<f8").tobytes()).decode()}
            for name, values in arrays.items()}  # fmt: skip
    return {**plain, "arrays": kept} if kept else plain


def described_target(tiles: Any) -> dict[str, Any] | None:
    """Description by which a target is recognized; None for tiles from an iterator."""
    if isinstance(tiles, Repeated):
        return {"kind": "Repeated", "solid": tiles.solid.name, "period": tiles.period,
                "sha256": digest(tiles.solid.vertices)}  # fmt: skip
    if isinstance(tiles, np.ndarray):
        return {"kind": "array", "shape": list(tiles.shape), "sha256": digest(tiles)}
    return described(tiles) if is_dataclass(tiles) else None


def described_focus(masks: FocusMasks | None) -> dict[str, Any] | None:
    """Depths [mm] of the focus planes and the plane of every column of the beam."""
    return None if masks is None else {"planes": list(masks.planes), "bin": np.argmax(masks.masks, axis=0).tolist()}


def _simple(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _simple(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_simple(part) for part in value]
    if callable(value) and hasattr(value, "__qualname__"):  # its repr would contain its address in memory
        return f"{value.__module__}.{value.__qualname__}"
    return value if isinstance(value, (int, float, str, bool, type(None))) else repr(value)


def wrap_from(description: Mapping[str, Any]) -> Wrap:
    """The machine that a folder describes. Raises `StorageError` for a machine that this library cannot rebuild."""
    kind = description.get("kind")
    if kind not in ("Roller", "roller"):
        raise StorageError(f"the web was carried by a {kind}; expected a Roller: simulate it with its own wrap=")
    kept = {"lit_share": 0.0, **description}  # a description without this key is from a film at rest while it is lit
    arrays = kept.pop("arrays", {})

    def array(name: str) -> np.ndarray:
        return np.frombuffer(b64decode(arrays[name]["float64"]), "<f8").reshape(arrays[name]["shape"]).astype(float)

    with malformed("the description of a Roller is malformed", "write the web again"):
        return read("wrap", {**kept, "kind": "roller"}, units=False, arrays=array)
