"""Letting go of machines: all of them, whatever becomes of one."""

from __future__ import annotations

from collections.abc import Callable, Sequence


def let_go(closers: Sequence[Callable[[], None]]) -> None:
    """Call all, the last first; then raise what went wrong first."""
    failed: list[Exception] = []
    for close in reversed(closers):
        try:
            close()
        except Exception as error:  # the others are let go of all the same
            failed.append(error)
    if failed:
        raise failed[0]
