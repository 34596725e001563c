"""A band of doses, or of responses to them, in which each voxel should lie."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.kernels.loss import band_loss, look_up
from vamgpu.kernels.signature import Kernel
from vamgpu.losses.loss import KernelLoss, steepest
from vamgpu.losses.response import Linear, Response

MOST = 1e12  # upper limit of weights and slacks: sums of their products must fit float32, which devices use
GREATEST_POWER = 64.0
"""Largest power of an excess: with a higher power, a dose three times the part's would exceed float32."""


def check_thresholds(outside: float, inside: float, most: float) -> None:
    """Raise `BadInput` for thresholds of the dose that are not in order."""
    if not 0 <= outside < inside <= most < MOST:
        raise BadInput(f"outside, inside, most are {outside!r}, {inside!r}, {most!r}; expected "
                       f"0 ≤ outside < inside ≤ most < {MOST:g}, such as 0.75, 0.95 and 1")  # fmt: skip


@dataclass(frozen=True)
class Band(KernelLoss):
    """Loss Σ w·gain·e^power + ridge·M², e = max(0, |M − c| − slack) with M = response(dose).

    Pairs are for outside and inside the part; fractional voxels are interpolated between both unless ``binary``.

    Args:
        center: The middle c of the band, in units of M, dimensionless.
        slack: Half width of the band about c, dimensionless.
        gain: A factor of the loss.
        power: Exponent of the excess.
        ridge: A factor of M².
        binary: A voxel belongs to the part if at least half of it is filled; no voxel counts partly.
        response: M(d), the response to a dose.
        weight: Weight w of each voxel [x, y, z], NumPy or on the device; None for 1.

    Raises:
        BadInput: A value is out of its range.
    """

    center: tuple[float, float]
    slack: tuple[float, float]
    gain: tuple[float, float] = (1.0, 1.0)
    power: float = 2.0
    ridge: float = 0.0
    binary: bool = False
    response: Response = Linear()
    weight: Any = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        pairs = len(self.slack) == len(self.gain) == 2
        bounded = all(0 <= value < MOST for value in (*self.slack, *self.gain, self.ridge))
        bounded = bounded and all(abs(value) < MOST for value in self.center)
        if not (pairs and bounded and 1 <= self.power <= GREATEST_POWER):
            raise BadInput(
                f"{self!r}: expected two values each of slack and gain, finite centers, the others ≥ 0 and below "
                f"{MOST:g}, and a power from 1 to {GREATEST_POWER:g}"
            )

    @classmethod
    def thresholds(cls, outside: float, inside: float, most: float = 1.0, power: float = 2.0) -> Band:
        """At most ``outside`` outside the part, between ``inside`` and ``most`` in it.

        Args:
            outside: Greatest dose outside, relative to the part's.
            inside: Least dose inside, relative to the part's.
            most: Greatest dose inside, relative to the part's.
            power: Exponent of the excess.

        Returns:
            The loss.

        Raises:
            BadInput: The values are not 0 ≤ outside < inside ≤ most.
        """
        check_thresholds(outside, inside, most)
        center, slack = (0.5 * outside, 0.5 * (inside + most)), (0.5 * outside, 0.5 * (most - inside))
        return cls(center, slack, (1.0 / power, 1.0 / power), power, binary=True)

    def launched(self, device: Device) -> tuple[Kernel, dict[str, Any]]:
        curve = self.response.curve()
        return band_loss, {
            "response": device.table(curve.values), "start": curve.start, "density": curve.density,
            "low": self.center[0], "high": self.center[1], "slack_low": self.slack[0], "slack_high": self.slack[1],
            "gain_low": self.gain[0], "gain_high": self.gain[1], "power": self.power, "ridge": self.ridge,
            "binary": int(self.binary),
        }  # fmt: skip

    def curvature(self) -> float:
        curve = self.response.curve()
        end = curve.start + (len(curve.values) - 1) / curve.density

        def loss(dose: np.ndarray, inside: int) -> np.ndarray:
            value, _ = look_up(dose, curve.values, curve.start, curve.density)
            excess = np.maximum(0.0, np.abs(value - self.center[inside]) - self.slack[inside])
            return self.gain[inside] * excess**self.power + self.ridge * value**2

        return max(steepest(lambda dose, k=k: loss(dose, k), curve.start, end) for k in (0, 1))
