"""What a print needs of a stage, whoever makes it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Stage(Protocol):
    """One axis; positions in its ``unit``, ``mm`` or ``deg``, and speeds in that a second."""

    unit: str

    def position(self) -> float:
        """Where the axis says it is."""
        ...

    def home(self) -> None:
        """Find the axis's zero; returns when it has."""
        ...

    def move(self, position: float, speed: float) -> None:
        """Begin to move to a position."""
        ...

    def run(self, speed: float) -> None:
        """Begin to move at a speed, for good; 0 brings the axis to rest."""
        ...

    def wait(self) -> None:
        """Return when the axis rests."""
        ...

    def stop(self) -> None:
        """Begin to come to rest."""
        ...

    def close(self) -> None:
        """Stop, and let go of the axis."""
        ...
