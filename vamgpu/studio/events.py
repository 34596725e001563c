"""One stream of events for all pages, which can be resumed after a lost connection."""

from __future__ import annotations

import asyncio
import json
import secrets
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from itertools import count
from threading import Lock
from typing import Any

KEPT = 2000  # largest number of events that a page may have missed
PERIOD, SILENCE = 0.1, 15.0
"""Time between two polls for events, and time after which a comment keeps a connection open [s]."""


class Events:
    """The newest events; any thread adds to them."""

    def __init__(self) -> None:
        self._boot, self._numbers, self._lock = secrets.token_hex(4), count(1), Lock()
        self._kept: deque[tuple[int, str]] = deque(maxlen=KEPT)
        self._last = 0

    def publish(self, name: str, data: dict[str, Any]) -> None:
        with self._lock:
            self._last = next(self._numbers)
            text = json.dumps(data, ensure_ascii=False)
            self._kept.append((self._last, f"id: {self._boot}-{self._last}\nevent: {name}\ndata: {text}\n\n"))

    def _begin(self, last: str | None) -> tuple[int, str]:
        """Number of the last event that a page knows, and the text to send it first."""
        boot, _, number = (last or "").partition("-")
        with self._lock:
            first = self._kept[0][0] if self._kept else self._last + 1
            if boot == self._boot and number.isdecimal() and first - 1 <= int(number) <= self._last:
                return int(number), ""
            return self._last, f"id: {self._boot}-{self._last}\nevent: reset\ndata: {{}}\n\n"

    async def stream(self, last: str | None, over: Callable[[], bool]) -> AsyncIterator[str]:
        """Events since the last one that a page knows, until ``over``."""
        known, first = self._begin(last)
        yield "retry: 1000\n" + (first or ": resumed\n\n")
        told = time.monotonic()
        while not over():
            with self._lock:
                new = [(number, text) for number, text in self._kept if number > known] if self._last > known else []
                lost = bool(new) and new[0][0] > known + 1
            if lost:
                known, first = self._begin(None)
                yield first
            for number, text in () if lost else new:
                known = number
                yield text
            if new:
                told = time.monotonic()
            elif time.monotonic() - told > SILENCE:
                told = time.monotonic()
                yield ": still here\n\n"
            await asyncio.sleep(PERIOD)
