"""vamgpu: tomographic volumetric 3D printing, from the optics of a vial to the frames of a projector.

``import vamgpu`` loads only NumPy of the large packages; others load when first used.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any

_STUB = Path(__file__).with_suffix(".pyi").read_text("utf-8")
_PUBLIC = {name: module for module, name in re.findall(r"^from (\S+) import \(?\s*(\w+) as \2\b", _STUB, re.M)}
"""Public name → module that defines it, as the stub for type checkers lists them."""

__version__ = "0.3.0.dev0"
__all__ = [*_PUBLIC, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"vamgpu has no {name!r}; it has {', '.join(_PUBLIC)}")
    if name == "live":  # the package of that name, which prints when it is called
        return import_module("vamgpu.live")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
