"""Transfers between host and device, and the memory that a device has allocated."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from vamgpu.errors import TransferForbidden

SMALL = 4096  # size of transfers (scalars, partial sums) that are always allowed [bytes]


@dataclass
class Ledger:
    """Transfers and memory of a device; ``transfers`` lists (direction, bytes) of all above 4 kB."""

    transfers: list[tuple[str, int]] = field(default_factory=list)
    small: int = 0
    allocated: int = 0
    peak: int = 0
    _forbidden: int = 0

    def cross(self, direction: str, nbytes: int) -> None:
        """Record a transfer; raises `TransferForbidden` for a large one inside ``forbid()``."""
        if nbytes <= SMALL:
            self.small += 1
            return
        if self._forbidden:
            raise TransferForbidden(
                f"{direction} of {nbytes} bytes inside no_transfers(); at most {SMALL} are allowed: "
                "keep the array on the device, or move the transfer out of the block"
            )
        self.transfers.append((direction, nbytes))

    def take(self, nbytes: int) -> None:
        """Record memory that was allocated."""
        self.allocated += nbytes
        self.peak = max(self.peak, self.allocated)

    def give(self, nbytes: int) -> None:
        """Record memory that was freed."""
        self.allocated -= nbytes

    def reset_peak(self) -> None:
        """Start measuring the peak from the memory allocated now."""
        self.peak = self.allocated

    @contextmanager
    def forbid(self) -> Iterator[None]:
        """Large transfers inside it raise an error; may be nested."""
        self._forbidden += 1
        try:
            yield
        finally:
            self._forbidden -= 1
