"""Tables of required doses, in the form that the kernel reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput

NEVER = -1e30  # a dose that is always present: no light is needed


@dataclass(frozen=True, eq=False)
class Targets:
    """Required Ω at the border of a slice; last entries hold beyond."""

    inner: np.ndarray  # [slices since the back side, slices to the front]
    back: np.ndarray  # [slices to the back side of the feature ahead]

    @property
    def horizon(self) -> int:
        """Number of slices to look ahead."""
        return max(self.inner.shape[1], len(self.back))


def sampled(profile: Callable[[np.ndarray, np.ndarray], np.ndarray], back: np.ndarray, front: np.ndarray) -> np.ndarray:
    """A profile at distances [mm] from the back side and to the front. Raises `BadInput` unless it holds doses."""
    step = back[1] if len(back) > 1 else 0.0
    grid = np.broadcast_arrays(back[:, None] + step, front[None, :])
    values = np.asarray(profile(*grid), dtype=np.float64)
    if values.shape != grid[0].shape or np.isnan(values).any():
        raise BadInput(f"the profile gave shape {values.shape}; expected a dose for each of {grid[0].shape} places")
    alike = (values == values[0]).all()
    return values[:1] if alike else values
