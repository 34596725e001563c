"""What an optimizer returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from vamgpu.backend.array import DeviceArray
from vamgpu.operators.linear import LinearOperator

if TYPE_CHECKING:
    from vamgpu.optimize.method import Method


@dataclass(frozen=True)
class Step:
    """One record of a run's history.

    iteration: counted from 1.  pairs: projector pairs (one forward and one back projection) spent so far, warm start
    included.  loss: the method's own.  window: strict process window of the dose the step looked at, (least dose in the
    part − greatest out of it) / greatest; accelerated methods look ahead of the light they hold.
    """

    iteration: int
    pairs: float
    loss: float
    window: float


@dataclass(frozen=True, eq=False)
class Plan:
    """Light that prints a target.

    sinogram: [angle, r, z] ≥ 0 on the operator's device, in units of the dose the part should get.  operator, method:
    what made it.  history: one `Step` an iteration.  window: strict process window of this very light.  pairs:
    projector pairs spent.  papers: what the method relies on.  seconds: of the run.  state: what resuming needs.
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

    def dose(self) -> DeviceArray:
        """Dose [x, y, z] of the light on the operator's device: Aᵀ sinogram."""
        return self.operator.T(self.sinogram)
