"""The doses, or responses, a target asks for."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.errors import BadInput
from vamgpu.methods.response import Linear, Response

MOST = 1e12
"""Weights and slacks are below this: sums of what they multiply must fit float32, as devices keep it."""
GREATEST_POWER = 64.0
"""Of an excess: that of a dose three times the part's to a higher power leaves float32."""


@dataclass(frozen=True)
class Band:
    """Loss Σ gain·e^power + ridge·M², e = max(0, |M − c| − slack) with M = response(dose).

    c, slack and gain are (outside, inside) the part; between for a fractional voxel unless ``binary``.
    """

    center: tuple[float, float]
    slack: tuple[float, float]
    gain: tuple[float, float] = (1.0, 1.0)
    power: float = 2.0
    ridge: float = 0.0
    binary: bool = False
    response: Response = Linear()

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
