"""Acts that must all be tried: a failure stops none of the others, and what a key interrupts is done again."""

from __future__ import annotations

from collections.abc import Callable

TRIES = 3
"""How often an act is begun that somebody interrupts; who presses the keys more often than that means it."""


def insist(*acts: Callable[[], object]) -> list[BaseException]:
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
