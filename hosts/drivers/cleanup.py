"""How machines are let go: acts that must all be tried, contexts that close, and packages that are missing."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol, Self

from vamgpu.errors import DeviceNotFound

log: logging.Logger = logging.getLogger(__name__)
TRIES = 3  # how often an act is begun that somebody interrupts; who presses the keys more often than that means it


def run_all(*acts: Callable[[], object]) -> list[BaseException]:
    """Do all of them; returns what went wrong."""
    failed: list[BaseException] = []
    for act in acts:
        for _ in range(TRIES):
            try:
                act()
            except Exception as error:
                failed.append(error)
            except BaseException as error:
                failed.append(error)
                continue
            break
    return failed


def close_all(closers: Sequence[Callable[[], None]]) -> None:
    """Call all, the last first; then raise what went wrong first."""
    if failed := run_all(*reversed(closers)):
        raise failed[0]


class Closing:
    """Closes itself at the end of its context."""

    def close(self) -> None:
        """Let go; more than once does no harm."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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
