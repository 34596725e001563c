"""What dose and correction ask of a printer, continuous or layer by layer."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from vamgpu.curethrough.profile import Profile
from vamgpu.curethrough.targets import Targets


class Machine(Protocol):
    """A printer with its resin; doses in critical doses, lengths along the print in slices."""

    @property
    def layered(self) -> bool:
        """Whether the platform stands while a slice is shown."""
        ...

    @property
    def slice_height(self) -> float:
        """h_s [mm]."""
        ...

    @property
    def eta(self) -> float:
        """Slice height over absorption height."""
        ...

    @property
    def decay(self) -> float:
        """1 − 10^−η."""
        ...

    @property
    def doses(self) -> np.ndarray:
        """Dose that one slice of each gray level adds at its border; float64 [256]."""
        ...

    @property
    def fade_scale(self) -> float:
        """Slices over which light fades e-fold, negative."""
        ...

    @property
    def tolerance(self) -> float:
        """Dose by which gray levels miss what is wanted, at the most."""
        ...

    @property
    def reached(self) -> float:
        """Dose behind a feature at which its back side counts as done."""
        ...

    @property
    def opened(self) -> float:
        """Dose to which a void must fall."""
        ...

    @property
    def tail(self) -> int:
        """Slices to show after the last."""
        ...

    def between(self, fraction: float) -> tuple[float, float]:
        """Shares (part, fade) of `expose_slices` for doses off the border."""
        ...

    def targets(self, profile: Profile) -> Targets:
        """Doses that the correction steers to; raises `BadInput` where there is nothing to steer with."""
        ...
