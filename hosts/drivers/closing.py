"""Contexts of drivers: what was opened is closed where the rest fails, and missing packages are named."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from vamgpu.errors import DeviceNotFound
from vamgpu.hosts.run_all import Closing, run_all

log: logging.Logger = logging.getLogger(__name__)


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


class ClosedOnce(Closing):
    """A machine that is brought to rest and let go of once; what fails of that is logged, and the rest is done."""

    called: str  # in the log
    _open = True

    def endings(self) -> tuple[Callable[[], object], ...]:
        """Acts that bring it to rest and let go of it, in order."""
        raise NotImplementedError

    def close(self) -> None:
        """Bring it to rest, and let go of it; more than once does no harm."""
        failed = run_all(*self.endings()) if self._open else []
        self._open = False
        for error in failed:
            log.warning("closing %s: %s", self.called, str(error) or type(error).__name__)
        if keys := [each for each in failed if not isinstance(each, Exception)]:
            raise keys[0]
