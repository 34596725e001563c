"""The number of threads for work outside kernels."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain, islice
from typing import TypeVar

In = TypeVar("In")
Out = TypeVar("Out")

MOST = 16
"""Beyond these, threads of one process wait for each other and for memory."""


def threads() -> int:
    """Threads to work in: one a core that this process may use, `MOST` at the most."""
    usable = getattr(os, "sched_getaffinity", None)
    return max(1, min(len(usable(0)) if usable else os.cpu_count() or 1, MOST))


def ahead(work: Callable[[In], Out], items: Iterable[In], most: int = MOST) -> Iterator[Out]:
    """Results of work on items, in order, by as many threads as cores, a few items ahead of whoever takes them."""
    # The work must let other threads run, as NumPy does; items are asked for in this thread.
    rest = iter(items)
    some = list(islice(rest, 2))
    workers = min(threads(), most)
    if len(some) < 2 or workers < 2:
        yield from map(work, chain(some, rest))
        return
    with ThreadPoolExecutor(workers) as pool:
        begun: deque[Future[Out]] = deque()
        for item in chain(some, rest):
            begun.append(pool.submit(work, item))
            if len(begun) > workers:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
