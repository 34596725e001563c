"""Band constraint Lp norm minimization."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, ClassVar

from vamgpu.errors import BadInput
from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss, Mean
from vamgpu.losses.response import Logistic, Response
from vamgpu.methods.descent import ByDescent
from vamgpu.methods.papers import BAND, ROLL_TO_ROLL


@dataclass(frozen=True)
class BCLP(ByDescent):
    """Band constraint Lp norm minimization: keeps a response M of the dose within a band around the target f.

    As published, with light g, dose d = Aᵀg and the voxels' weights w:

        minimize (Σ w·max(0, |M(d) − f| − ε)^p)^(q/p),    g ← max(0, g − η·∂/∂g)

    and in the roll-to-roll paper with λ·Σ M(d)² added, the L2 regularization (S1), and momentum. The paper prints it
    without max(0, …), which would penalize voxels inside their band, and without the last sum. If λ > 0 and q ≠ p,
    both sums are means over the voxels: with sums, λ would outweigh the norm on finer voxels.

    What differs here: the step η is not fixed. The first step changes the light by ``share``, and each further step is
    ``growth`` times as long. A step that raises the loss is undone; the next one is half as long and without momentum.
    With steps that only grew, the loss of a web rose from 80 to 2352 without a warning. Momentum is Nesterov's.

    Args:
        p: Exponent, ≥ 1.
        q: Exponent of the sum, ≥ 1. None makes q = p, which keeps distant parts of a print independent.
        slack: Half widths ε of the band outside and inside the part, dimensionless.
        penalty: Weight w of a voxel outside and inside the part.
        ridge: Weight λ of the regularization.
        response: M(d), the response to a dose.
        share: Relative change of the light in the first step, > 0.
        growth: Factor from one step to the next, ≥ 1.
        momentum: Share of the last step that is added to the next, in [0, 1).
        weight: Further weight of each voxel [x, y, z], NumPy or on the device; None for 1.

    Raises:
        BadInput: For values out of these ranges.
    """

    p: float = 2.0
    q: float | None = None
    slack: tuple[float, float] = (0.05, 0.01)
    penalty: tuple[float, float] = (1.0, 1.0)
    ridge: float = 0.0
    response: Response = Logistic()
    share: float = 0.05
    growth: float = 1.1
    momentum: float = 0.0
    weight: Any = field(default=None, compare=False, repr=False)
    papers: ClassVar[tuple[str, ...]] = (BAND, ROLL_TO_ROLL)
    iterations: ClassVar[int] = 100

    def __post_init__(self) -> None:
        if self.q is not None and not 1 <= self.q < inf:
            raise BadInput(f"q is {self.q}; expected q ≥ 1, or None for that of p = {self.p}")
        super().__post_init__()

    @classmethod
    def paper_002(cls) -> BCLP:
        """Values that the roll-to-roll paper prints: p = 3, ε = 0.05 / 0.01, B = 10, momentum 0.5, λ = 0.04.

        It does not print q, the weights, the learning rate and the logistic's middle. Here q = p, which keeps segments
        of a web independent; the weights are 1, the step length adapts, and the middle is half the part's dose.
        """
        return cls(p=3.0, ridge=0.04, momentum=0.5)

    @classmethod
    def roll_to_roll(cls) -> BCLP:
        """The reference run of the roll-to-roll paper, with values for what its text leaves open: q = 1, weight 3 in
        the part, learning rate 0.01, the logistic's middle at half the part's dose.

        A learning rate depends on the unit of light, which the paper does not state. Here, the first step changes the
        light by one percent. Later steps use the same learning rate, unless that would raise the loss. q = 1 couples a
        whole web through one number. `optimize` updates this number at each step of a `WebProjection`; `Stream` takes
        it once, from the first segment.
        """
        return replace(cls.paper_002(), q=1.0, penalty=(1.0, 3.0), share=0.01, growth=1.0)

    def band(self) -> Band:
        """The loss of a voxel, if q is p."""
        return self._band(self.ridge)

    def apart(self, excess: float) -> BCLP:
        """The loss with q = p, regularized so that its minimum is the same; distant parts are then independent.

        The power q/p scales the norm's gradient by q/p·excess^(q/p − 1); the regularization is divided by this factor.

        Args:
            excess: Mean over the voxels of w·max(0, |M(d) − f| − ε)^p at that minimum, ≥ 0.

        Returns:
            The method.
        """
        if self.q is None:
            return self
        return replace(self, q=None, ridge=self.ridge * self.p / self.q * excess ** max(0.0, 1.0 - self.q / self.p))

    def _band(self, ridge: float) -> Band:
        return Band((0.0, 1.0), self.slack, self.penalty, self.p, ridge, response=self.response, weight=self.weight)

    @property
    def loss(self) -> Loss:
        """The whole loss."""
        if self.q in (None, self.p):
            return self.band()
        if not self.ridge:
            return self.band() ** (self.q / self.p)
        nothing = Band((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), ridge=self.ridge, response=self.response, weight=self.weight)
        return Mean(self._band(0.0)) ** (self.q / self.p) + Mean(nothing)

    @property
    def coupling(self) -> str:
        """Reason why distant positions on a web depend on each other; empty if they do not."""
        if self.q in (None, self.p):
            return self.loss.coupling
        return f"q is {self.q} with p = {self.p}: that couples the whole web; expected q = p, or None"
