"""How many threads work at once on what no kernel does."""

from __future__ import annotations

import os

MOST = 16
"""Beyond these, threads of one process wait for each other and for memory."""


def threads() -> int:
    """Count the threads to work in.

    Returns:
        One a core that this process may use, `MOST` at the most.
    """
    usable = getattr(os, "sched_getaffinity", None)
    return max(1, min(len(usable(0)) if usable else os.cpu_count() or 1, MOST))
