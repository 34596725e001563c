"""Release of machines: acts that must all be tried, contexts that close, and missing packages."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol, Self

from vamgpu.errors import DeviceNotFound

log: logging.Logger = logging.getLogger(__name__)
TRIES = 3  # how often an interrupted action is repeated; the next Ctrl-C ends it


def run_all(*acts: Callable[[], object]) -> list[BaseException]:
    """Do all of them; returns the errors."""
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


def all_of(*acts: Callable[[], object]) -> None:
    """Do all of them; then raise the first error."""
    if failed := run_all(*acts):
        raise failed[0]


def close_all(closers: Sequence[Callable[[], None]]) -> None:
    """Call all, the last first; then raise the first error."""
    all_of(*reversed(closers))


class Closing:
    """A context that closes itself at its end."""

    def close(self) -> None:
        """Release it; may be called more than once."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Closable(Protocol):
    """Something that holds a port, a device or a file."""

    def close(self) -> object: ...  # release it


@contextmanager
def closed_on_error(opened: Closable) -> Iterator[None]:
    """Close what was opened if the context fails."""
    try:
        yield
    except BaseException:
        opened.close()
        raise


@contextmanager
def extra(name: str, need: str) -> Iterator[None]:
    """Raise `DeviceNotFound` if the packages of an extra cannot be imported."""
    try:
        yield
    except ImportError as error:
        raise DeviceNotFound(f'{need}: pip install "vamgpu[{name}]"') from error


class ClosedOnce(Closing):
    """A machine that is stopped and released once; failures are logged, and the rest is still done."""

    called: str  # its name in the log
    _open = True

    def endings(self) -> tuple[Callable[[], object], ...]:
        """Acts that stop it and release it, in order."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop it and release it; may be called more than once."""
        failed = run_all(*self.endings()) if self._open else []
        self._open = False
        for error in failed:
            log.warning("closing %s: %s", self.called, str(error) or type(error).__name__)
        if keys := [each for each in failed if not isinstance(each, Exception)]:
            raise keys[0]
