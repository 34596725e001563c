"""What a folder remembers of a web, in plain values: enough to read its frames, and to tell it from another web."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np

from vamgpu.errors import StorageError
from vamgpu.printing.focus import FocusMasks
from vamgpu.schema.read import read
from vamgpu.storage.folder import digest
from vamgpu.targets.stream import Repeated
from vamgpu.web import Wrap


def described(value: Any) -> dict[str, Any]:
    """A frozen noun as plain values: its kind and its fields."""
    fields = asdict(value) if is_dataclass(value) and not isinstance(value, type) else {}
    return {"kind": type(value).__name__, **{key: _simple(part) for key, part in fields.items()}}


def described_target(tiles: Any) -> dict[str, Any] | None:
    """What a target says of itself, to tell it from another; None for tiles that come and go."""
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
    if callable(value) and hasattr(value, "__qualname__"):  # its repr tells where it lies in this process's memory
        return f"{value.__module__}.{value.__qualname__}"
    return value if isinstance(value, (int, float, str, bool, type(None))) else repr(value)


def wrap_from(description: Mapping[str, Any]) -> Wrap:
    """The machine that a folder describes. Raises `StorageError` for one this library cannot rebuild."""
    kind = description.get("kind")
    if kind not in ("Roller", "roller"):
        raise StorageError(f"the web was carried by a {kind}; expected a Roller: simulate it with its own wrap=")
    try:
        return read("wrap", {**description, "kind": "roller"}, units=False)
    except (TypeError, ValueError) as error:
        raise StorageError(f"the description of a Roller is garbled: {error}; write the web again") from error
