"""What an optimizer returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from vamgpu.backend.array import DeviceArray
from vamgpu.operators.linear import LinearOperator

if TYPE_CHECKING:
    from vamgpu.methods.method import Method


@dataclass(frozen=True)
class Step:
    """One record of a run's history.

    Attributes:
        iteration: Counted from 1.
        pairs: Projector pairs (one forward and one back projection) spent so far, warm start included.
        loss: The method's own: of the light it holds where light is chosen by the loss; otherwise of the point the step
            looked at, which accelerated methods take ahead of the light they hold.
        window: Strict process window of the light held, (least dose in the part − greatest out of it) / greatest; −1
            for light that gives no dose at all.
    """

    iteration: int
    pairs: float
    loss: float
    window: float


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """Light that prints a target: the best that a run evaluated, not its last.

    Best is the light of the greatest strict window, or of the least loss, as the method's ``criterion`` says.

    Attributes:
        sinogram: [angle, r, z] ≥ 0 on the operator's device, in units of the dose the part should get.
        operator: What made it.
        method: What made it.
        history: One `Step` an iteration.
        window: Strict process window of this very light.
        pairs: Projector pairs that the method spent. Whether light reaches the part is asked before, in one pair, and
            the light is chosen after, in half a pair; neither is counted, as no method has a say in them.
        papers: What the method relies on.
        seconds: Of the run.
        target_name: Of what it prints.
        state: What resuming needs; a resumed run goes on from its last light, not from the best.
        best_iteration: Number of iterations after which this light was reached; 0 is the first guess.
    """

    sinogram: DeviceArray
    operator: LinearOperator
    method: Method
    history: tuple[Step, ...]
    window: float
    pairs: float
    papers: tuple[str, ...]
    seconds: float
    target_name: str
    state: dict[str, Any] = field(default_factory=dict, repr=False)
    best_iteration: int = 0

    def __repr__(self) -> str:
        return f"Plan({self.target_name!r}: strict window {self.window:+.4f} after {self.pairs:g} pairs)"

    def dose(self) -> DeviceArray:
        """Dose [x, y, z] of the light on the operator's device: Aᵀ sinogram."""
        return self.operator.T(self.sinogram)
