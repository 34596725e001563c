"""A band of doses, or of responses to them, in which each voxel should lie."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.loss import band_loss, look_up
from vamgpu.losses.loss import Loss, steepest
from vamgpu.losses.response import Linear, Response
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import EVERYWHERE, folded, parts_for

MOST = 1e12
"""Weights and slacks are below this: sums of what they multiply must fit float32, as devices keep it."""
GREATEST_POWER = 64.0
"""Of an excess: that of a dose three times the part's to a higher power leaves float32."""
SINGLE = "a weight of single voxels has no place on an endless web; use price or gain for inside and outside"


@dataclass(frozen=True)
class Band(Loss):
    """Loss Σ w·gain·e^power + ridge·M², e = max(0, |M − c| − slack) with M = response(dose).

    c, slack and gain are (outside, inside) the part; between for a fractional voxel unless ``binary``.
    weight: w of each voxel [x, y, z], NumPy or on the device; None for 1.  Raises `BadInput`.
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
                f"{self!r}: wanted two of slack and gain, centers that are numbers, the others ≥ 0 and below {MOST:g}, "
                f"and a power from 1 to {GREATEST_POWER:g}"
            )

    @classmethod
    def thresholds(cls, outside: float, inside: float, most: float = 1.0, power: float = 2.0) -> Band:
        """At most ``outside`` where nothing is, between ``inside`` and ``most`` in the part; both doses of the part.

        Raises `BadInput` unless 0 ≤ outside < inside ≤ most.
        """
        if not 0 <= outside < inside <= most:
            raise BadInput(f"thresholds {outside}, {inside}, {most}; wanted 0 ≤ outside < inside ≤ most")
        center, slack = (0.5 * outside, 0.5 * (inside + most)), (0.5 * outside, 0.5 * (most - inside))
        return cls(center, slack, (1.0 / power, 1.0 / power), power, binary=True)

    @property
    def coupling(self) -> str:
        return "" if self.weight is None else SINGLE

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        if out is not dose:
            combine(1.0, dose, 0.0, dose, out)
        parts, curve = parts_for(band_loss, out), self.response.curve()
        out.device.launch(
            band_loss,
            dose=out,
            target=target,
            weight=target if self.weight is None else self.weight,
            weighted=int(self.weight is not None),
            response=out.device.table(curve.values),
            start=curve.start,
            density=curve.density,
            low=self.center[0],
            high=self.center[1],
            slack_low=self.slack[0],
            slack_high=self.slack[1],
            gain_low=self.gain[0],
            gain_high=self.gain[1],
            power=self.power,
            ridge=self.ridge,
            binary=int(self.binary),
            reach=reach,
            parts=parts,
        )
        return folded(parts)

    def curvature(self) -> float:
        curve = self.response.curve()
        end = curve.start + (len(curve.values) - 1) / curve.density

        def loss(dose: np.ndarray, inside: int) -> np.ndarray:
            value, _ = look_up(dose, curve.values, curve.start, curve.density)
            excess = np.maximum(0.0, np.abs(value - self.center[inside]) - self.slack[inside])
            return self.gain[inside] * excess**self.power + self.ridge * value**2

        return max(steepest(lambda dose, k=k: loss(dose, k), curve.start, end) for k in (0, 1))

    def on(self, field: Callable[[Any], DeviceArray | None]) -> Band:
        return self if self.weight is None else replace(self, weight=field(self.weight))
