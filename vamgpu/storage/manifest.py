"""Manifests of job folders, in readable JSON."""

from __future__ import annotations

import json
import platform
import re
import reprlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import UTC, datetime
from importlib import metadata
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu import __version__
from vamgpu.errors import BadInput, StorageError
from vamgpu.storage.reading import malformed, parse_json

FORMAT = "vamgpu job"
VERSION = 2
READ = (1, 2)
"""Versions that can be read. Frames of version 1 are a projector's bytes; those of version 2 may be plain patterns."""
UNITS = {
    "length": "mm",
    "time": "s",
    "energy": "mJ",
    "power": "mW",
    "irradiance": "mW/mm²",
    "dose": "mJ/mm³",
    "absorption": "1/mm",
    "angle": "rad",
}
ROW = re.compile(r"\[\n([^\[\]{}]*?)\n\s*\]")
"""A list of plain values over several lines; in JSON, text never contains a line break."""
PACKAGES = ("numpy", "zarr", "pyopencl", "warp-lang")


@dataclass(frozen=True)
class ArrayRecord:
    """One array: its shape, NumPy type, axes, unit, and the SHA-256 of its bytes in C order, little-endian."""

    shape: tuple[int, ...]
    dtype: str
    axes: tuple[str, ...]
    unit: str
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """Everything needed to read a job folder, and its origin."""

    # versions of this library, Python and the packages that it computes with

    inputs: dict[str, Any]  # settings of the job
    details: dict[str, Any]  # information for readers of its arrays, by subject
    device: str  # the device of the computation
    arrays: dict[str, ArrayRecord]  # by name
    versions: dict[str, str] = field(default_factory=lambda: versions())
    units: dict[str, str] = field(default_factory=lambda: dict(UNITS))
    written: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))

    def to_json(self) -> str:
        """The manifest as text. Raises `BadInput` for inputs that JSON cannot hold."""
        head = {"format": FORMAT, "version": VERSION}
        body = {name: plain(getattr(self, name), name) for name in (f.name for f in fields(self))}
        text = json.dumps({**head, **body}, indent=2, ensure_ascii=False)
        return ROW.sub(lambda row: "[" + " ".join(row[1].split()) + "]", text) + "\n"

    @classmethod
    def from_json(cls, text: str, path: Path) -> Manifest:
        """Read a manifest; raises `StorageError` for contents that this version cannot read."""
        try:
            data = parse_json(text)
        except ValueError as error:
            raise StorageError(f"{str(path)!r} is not valid JSON: {error}; write the job again") from error
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise StorageError(f"{str(path)!r} is not a manifest of a {FORMAT}; check the path")
        if data.get("version") not in READ:
            raise StorageError(
                f"{str(path)!r} has version {data.get('version')!r}, this library reads {READ[0]} to {READ[-1]}; "
                "read it with the library that wrote it"
            )
        with malformed(f"in {str(path)!r} this is missing or malformed", "the job is damaged, write it again"):
            arrays = {name: _record(name, record) for name, record in data["arrays"].items()}
            known = {name: data[name] for name in ("inputs", "details", "device", "versions", "units", "written")}
            for name, value in known.items():
                if not isinstance(value, str if name in ("device", "written") else dict):
                    raise TypeError(f"{name}, which is {reprlib.repr(value)}")
            return cls(arrays=arrays, **known)


def _record(name: str, record: dict[str, Any]) -> ArrayRecord:
    shape, axes, plain = record["shape"], record["axes"], (record["dtype"], record["unit"], record["sha256"])
    counts = isinstance(shape, list) and all(type(n) is int and n > 0 for n in shape)
    texts = isinstance(axes, list) and all(isinstance(text, str) for text in (*axes, *plain))
    if not (name.isidentifier() and shape and counts and texts):
        raise ValueError(f"array {reprlib.repr(name)}, which is {reprlib.repr(record)}")
    return ArrayRecord(tuple(shape), plain[0], tuple(axes), *plain[1:])


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Versions of this library, of Python, and of packages as far as they are installed."""
    found = {"vamgpu": __version__, "python": platform.python_version()}
    for package in packages:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def plain(value: Any, name: str = "manifest") -> Any:
    """Turn a value into JSON's own types; dataclasses become objects, paths text."""
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        if not isfinite(value):
            raise BadInput(f"{name} is {value!r}; a manifest holds finite numbers only")
        return float(value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), name)
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name), f"{name}.{f.name}") for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item, f"{name}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, f"{name}[{index}]") for index, item in enumerate(value)]
    raise BadInput(
        f"{name} is a {type(value).__name__}; expected numbers, text, lists, mappings or dataclasses of them"
    )
