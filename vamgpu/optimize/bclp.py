"""Band constraint Lp norm minimization."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import Any, ClassVar

from vamgpu.errors import BadInput
from vamgpu.optimize.band import Band
from vamgpu.optimize.descent import Descent
from vamgpu.optimize.fbp import filtered_light
from vamgpu.optimize.method import Steps
from vamgpu.optimize.papers import BAND, ROLL_TO_ROLL
from vamgpu.optimize.ramp import identity
from vamgpu.optimize.response import Logistic, Response
from vamgpu.optimize.work import Work


@dataclass(frozen=True)
class BCLP:
    """Minimizes (Σ w·max(0, |M − f| − ε)^p)^(q/p) + ridge·Σ M², M = response(dose), f the target's fractions.

    The band has slack: without max(0, …), as sometimes printed, voxels inside it would be penalized.

    p, q: any ≥ 1; None makes q = p, so that distant parts of a print do not couple.  slack: ε outside and inside the
    part.  price: w outside and inside.  weight: further w for each voxel [x, y, z], NumPy or on the device, or None.
    ridge: λ_reg, needs q = p.  share, growth, momentum: as in `GradientDescent`.  Raises `BadInput`.
    """

    p: float = 2.0
    q: float | None = None
    slack: tuple[float, float] = (0.05, 0.01)
    price: tuple[float, float] = (1.0, 1.0)
    ridge: float = 0.0
    response: Response = Logistic()
    share: float = 0.05
    growth: float = 1.1
    momentum: float = 0.0
    weight: Any = field(default=None, compare=False, repr=False)
    papers: ClassVar[tuple[str, ...]] = (BAND, ROLL_TO_ROLL)
    iterations: ClassVar[int] = 100

    def __post_init__(self) -> None:
        self.band()
        if self.q is not None and (not 1 <= self.q < inf or (self.ridge > 0 and self.q != self.p)):
            raise BadInput(
                f"q is {self.q} with p = {self.p} and ridge = {self.ridge}; wanted q ≥ 1, and q = p with a ridge"
            )
        if not (0 < self.share < inf and 1 <= self.growth < inf and 0 <= self.momentum < 1):
            raise BadInput(f"{self!r}: wanted share > 0, growth ≥ 1 and 0 ≤ momentum < 1")

    @classmethod
    def paper_002(cls) -> BCLP:
        """The choices of the roll-to-roll paper: p = 3, ε = 0.05 / 0.01, B = 10, momentum 0.5, λ = 0.04.

        What it leaves open is ours: q = p, the logistic's middle at half the part's dose, and the size of a step.
        """
        return cls(p=3.0, ridge=0.04, momentum=0.5)

    def band(self) -> Band:
        """The loss of a voxel."""
        return Band((0.0, 1.0), self.slack, self.price, self.p, self.ridge, response=self.response)

    def steps(self, work: Work) -> Steps:
        if "light" not in work.memory:
            filtered_light(work, work.volume())
        order = self.q if self.q is not None and self.q != self.p else None
        yield from Descent(
            self.band(),
            identity(work.operator),
            share=self.share,
            growth=self.growth,
            momentum=self.momentum,
            order=order,
            weight=work.field(self.weight),
        ).steps(work)
