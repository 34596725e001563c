"""Light on a web that differs from the planned one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.web import Wrap


@dataclass(frozen=True)
class WebDrift:
    """A change of the light of a web, from some frame on.

    Args:
        gain: Light relative to the plan, dimensionless.
        since: First frame with this light.
        absorption: Absorption coefficient of the film relative to the plan, dimensionless. That of the last drift
            applies to the whole web, because it belongs to the resin.

    Raises:
        BadInput: A value is out of its range.
    """

    gain: float = 1.0
    since: int = 0
    absorption: float = 1.0

    def __post_init__(self) -> None:
        positive("gain of the light", self.gain)
        positive("absorption over planned", self.absorption)
        if isinstance(self.since, bool) or not isinstance(self.since, int) or self.since < 0:
            raise BadInput(f"a drift begins at frame {self.since!r}; expected a whole number ≥ 0")


def gains(drifts: Sequence[WebDrift], first: int, stop: int) -> np.ndarray:
    """Light relative to the plan of each frame from ``first`` to ``stop``, (frames,)."""
    found = np.ones(stop - first)
    for drift in sorted(drifts, key=lambda each: each.since):
        found[max(drift.since - first, 0) :] = drift.gain
    return found


def drifts_of(details: Mapping[str, Any]) -> tuple[WebDrift, ...]:
    """Drifts of a folder's frames; none for a web that was never replanned."""
    return tuple(WebDrift(**each) for each in details.get("replanned", {}).get("drifts", ()))


def clouded(wrap: Wrap, absorption: float) -> Wrap:
    """The machine with a film of another absorption. Raises `BadInput` for a machine without an absorbing film."""
    if absorption == 1.0:
        return wrap
    film: Any = getattr(wrap, "film", None)
    if not getattr(film, "absorption", 0.0):
        raise BadInput(f"{wrap!r} has no film that absorbs; expected absorption=1")
    return replace(wrap, film=replace(film, absorption=absorption * film.absorption))  # type: ignore[type-var]
