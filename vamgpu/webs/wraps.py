"""Machines that carry a web, to and from plain values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vamgpu.errors import StorageError
from vamgpu.schema.read import read
from vamgpu.web import Wrap


def wrap_from(description: Mapping[str, Any]) -> Wrap:
    """The machine that a folder describes. Raises `StorageError` for one this library cannot rebuild."""
    kind = description.get("kind")
    if kind not in ("Roller", "roller"):
        raise StorageError(f"the web was carried by a {kind}; wanted a Roller: simulate it with its own wrap=")
    try:
        return read("wrap", {**description, "kind": "roller"}, units=False)
    except (TypeError, ValueError) as error:
        raise StorageError(f"the description of a Roller is garbled: {error}; write the web again") from error
