"""Acts that must all be tried: a failure stops none of the others, and what a key interrupts is done again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Self

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
