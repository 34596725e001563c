"""The number of threads for work outside kernels."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain, islice
from threading import current_thread
from typing import Any, TypeVar

import numpy as np

In = TypeVar("In")
Out = TypeVar("Out")

MOST, FEW = 8, 4  # limit of threads: more of them wait for memory, and for each other if operations are short
PIECE = 65_536  # number of values that a thread processes
WORKER = "vamgpu"  # prefix of the names of threads whose work is not divided again


def threads() -> int:
    """Number of threads to use: one per core that this process may use, at most `MOST`."""
    usable = getattr(os, "sched_getaffinity", None)
    return max(1, min(len(usable(0)) if usable else os.cpu_count() or 1, MOST))


def pool(workers: int) -> ThreadPoolExecutor:
    """Number of threads for work that is divided."""
    return ThreadPoolExecutor(workers, WORKER)


def ahead(work: Callable[[In], Out], items: Iterable[In], most: int = MOST) -> Iterator[Out]:
    """Results of work on items, in order, computed by as many threads as cores, a few items ahead of the caller."""
    # The work must release the interpreter lock, as NumPy does; items are taken in this thread.
    rest = iter(items)
    some = list(islice(rest, 2))
    workers = min(threads(), most)
    if len(some) < 2 or workers < 2 or current_thread().name.startswith(WORKER):
        yield from map(work, chain(some, rest))
        return
    with pool(workers) as others:
        begun: deque[Future[Out]] = deque()
        for item in chain(some, rest):
            begun.append(others.submit(work, item))
            if len(begun) > workers:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()


def beside(task: Callable[[], Out]) -> Callable[[], Out]:
    """Begin a task without a device in a thread that divides its work like any other; returns a wait for its result."""
    alone = ThreadPoolExecutor(1)
    begun = alone.submit(task)
    alone.shutdown(wait=False)
    return begun.result


def together(*tasks: Callable[[], Any]) -> list[Any]:
    """Results of tasks, run in parallel on the available cores."""
    return list(ahead(lambda task: task(), tasks))


def pointwise(work: Callable[..., tuple[np.ndarray, ...]], *values: np.ndarray) -> list[np.ndarray]:
    """Fields (n,) computed point by point from values (n,), in pieces, by as many threads as cores."""
    count = len(values[0])
    some = [slice(first, first + PIECE) for first in range(0, max(count, 1), PIECE)]
    fields: list[np.ndarray] = []
    for part, own in zip(some, ahead(lambda part: work(*(each[part] for each in values)), some, FEW), strict=True):
        fields = fields or [np.empty(count, each.dtype) for each in own]
        for field, each in zip(fields, own, strict=True):
            field[part] = each
    return fields
