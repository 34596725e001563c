"""The lease: a controller keeps the light on only as long as a host that works keeps saying so."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

from vamgpu.errors import BadInput
from vamgpu.hosts.schedules.timing import whole

DEFAULT_LENGTH = 250_000_000
"""How long a controller keeps the light without being told to [ns]."""

SHORTEST = 10_000_000
"""Least length of a lease [ns]."""


class Time(Protocol):
    """A clock as the lease sees it."""

    def now(self) -> int:
        """The time [ns]."""
        ...


class Lease:
    """What a host must renew. It is renewed for work done, never for mere time passed.

    renew: tells the controller to keep the light for ``length`` [ns] more; raises what its line raises. stall: how old
    the last sign of work may be [ns]; by default as long as the lease. A host whose GPU, disk or feed hangs stops
    giving signs, so that a renewing thread that still lives does not keep the light of a print that does not. Raises
    `BadInput`.
    """

    def __init__(
        self,
        clock: Time,
        renew: Callable[[int], None],
        length: int = DEFAULT_LENGTH,
        stall: int | None = None,
    ) -> None:
        self.length = whole("the lease [ns]", length)
        if self.length < SHORTEST:
            raise BadInput(f"a lease of {length} ns; wanted 10 ms or more, which a line and a scheduler can hold")
        self.stall = self.length if stall is None else whole("stall [ns]", stall)
        self._clock, self._renew = clock, renew
        self._lock = threading.Lock()
        self._until: int | None = None
        self._sign: int | None = None
        self._revoked = False

    def begin(self) -> None:
        """Take the lease, with a sign of work now."""
        with self._lock:
            self._revoked = False
            self._sign = self._clock.now()
        self.keep(force=True)

    def beat(self) -> None:
        """Give a sign of work."""
        self._sign = self._clock.now()

    def keep(self, force: bool = False) -> bool:
        """Renew where a quarter of the lease has passed and there was work; whether the controller was told."""
        with self._lock:
            now = self._clock.now()
            if self._revoked or self._sign is None or now - self._sign > self.stall:
                return False
            if not force and self._until is not None and self._until - now > 3 * self.length // 4:
                return False
            self._renew(self.length)
            # Counted from before the message left: the controller counts from its arrival, which is later.
            self._until = now + self.length
            return True

    def fresh(self, now: int | None = None) -> bool:
        """Whether the controller still keeps the light, as far as the host can know."""
        until = self._until
        at = self._clock.now() if now is None else now
        return not self._revoked and until is not None and at < until

    def revoke(self) -> None:
        """Never renew again; needs no line and cannot fail."""
        self._revoked = True
        self._until = None
