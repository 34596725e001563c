"""Every declared kernel, read off the files beside this one."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from vamgpu.kernels.signature import Kernel

FOLDER = Path(__file__).parent


def concepts() -> tuple[str, ...]:
    """Names of the concepts: files with an OpenCL sibling."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.cl")))


def kernels() -> tuple[Kernel, ...]:
    """Every kernel of every concept."""
    found = []
    for concept in concepts():
        module = import_module(f"vamgpu.kernels.{concept}")
        own = (value for value in vars(module).values() if isinstance(value, Kernel) and value.concept == concept)
        found += list(own)
    return tuple(found)
