"""Contexts of drivers: what was opened is closed where the rest fails, and missing packages are named."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from vamgpu.errors import DeviceNotFound


class Closable(Protocol):
    """Something that holds a port, a device or a file."""

    def close(self) -> object: ...  # let go of it


@contextmanager
def closed_on_error(opened: Closable) -> Iterator[None]:
    """Close what was opened where the context fails."""
    try:
        yield
    except BaseException:
        opened.close()
        raise


@contextmanager
def extra(name: str, need: str) -> Iterator[None]:
    """Raise `DeviceNotFound` where the packages of an extra cannot be imported."""
    try:
        yield
    except ImportError as error:
        raise DeviceNotFound(f'{need}: pip install "vamgpu[{name}]"') from error
