"""Machines that carry a web, to and from plain values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vamgpu.errors import StorageError
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.web import Wrap


def wrap_from(description: Mapping[str, Any]) -> Wrap:
    """The machine that a folder describes. Raises `StorageError` for one this library cannot rebuild."""
    fields = dict(description)
    kind = fields.pop("kind", None)
    try:
        if kind == "Roller":
            film = dict(fields.pop("film"))
            substrate = film.pop("substrate", None)
            return Roller(film=Film(**film, substrate=None if substrate is None else tuple(substrate)), **fields)
    except (TypeError, ValueError) as error:
        raise StorageError(f"the description of a Roller is garbled: {error}; write the web again") from error
    raise StorageError(f"the web was carried by a {kind}; wanted a Roller: simulate it with its own wrap=")
