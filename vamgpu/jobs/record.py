"""What a job folder remembers of how its light was found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from vamgpu.errors import StorageError


@dataclass(frozen=True)
class PlanRecord:
    """A plan without its light: method as text, history as plain records, citations, seconds, strict window."""

    method: str
    history: tuple[Mapping[str, float], ...]
    papers: tuple[str, ...]
    seconds: float
    window: float

    @classmethod
    def of(cls, plan: Any, window: float | None = None) -> PlanRecord:
        """The record of a `Plan`, or of another with a window of its own."""
        history = tuple(asdict(step) for step in plan.history)
        window = float(plan.window if window is None else window)
        return cls(repr(plan.method), history, tuple(map(str, plan.papers)), float(plan.seconds), window)

    @classmethod
    def read(cls, data: Any) -> PlanRecord:
        """From a manifest; raises `StorageError` for what is no record."""
        try:
            return cls(
                str(data["method"]), tuple(data["history"]), tuple(data["papers"]), data["seconds"], data["window"]
            )
        except (KeyError, TypeError) as error:
            raise StorageError(f"the manifest garbles its plan: {error}; write the job again") from error
