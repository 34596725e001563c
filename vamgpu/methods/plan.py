"""What an optimizer returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.card import card, drawable
from vamgpu.methods.certificate import Bound
from vamgpu.methods.part import idle_light, lit_pixels, on_device
from vamgpu.operators.compose import combine
from vamgpu.operators.defocus import Defocused
from vamgpu.operators.protocol import Operator

if TYPE_CHECKING:
    from vamgpu.methods.method import Method
    from vamgpu.methods.tolerances import CornerDoses, Tolerances


@dataclass(frozen=True)
class Step:
    """One record of a run's history.

    Attributes:
        iteration: Counted from 1.
        evaluations: Projector evaluations (one forward and one back projection) spent so far, warm start included.
        loss: The method's own: of the light it holds where light is chosen by the loss; otherwise of the point the step
            looked at, which accelerated methods take ahead of the light they hold.
        window: Strict process window of the light held, (least dose in the part − greatest out of it) / greatest; −1
            for light that gives no dose at all.
    """

    iteration: int
    evaluations: float
    loss: float
    window: float


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """Light that prints a target: the best that a run evaluated, not its last.

    Best is the light of the greatest strict window, or of the least loss, as the method's ``criterion`` says.

    Attributes:
        sinogram: [angle, r, z] ≥ 0 on the operator's device, in units of the dose the part should get.
        operator: The projector it was found for.
        method: The method that found it.
        history: One `Step` an iteration.
        window: Strict process window of this very light, a share of the greatest dose.
        evaluations: Projector evaluations that the method spent. One before, to see whether light reaches the part, and
            half of one after, to choose the light, are not counted: no method has a say in them.
        papers: What the method relies on.
        seconds: How long the run took [s].
        target_name: Of what it prints.
        state: What resuming needs; a resumed run goes on from its last light, not from the best.
        best_iteration: Number of iterations after which this light was reached; 0 is the first guess.
        bound: How wide a window any light can have, where the method tells; else see `vamgpu.methods.bound`.
        target: What it prints, as it was given to `optimize`; None where nobody said.
        tolerances: That the light was sought for; ``window`` and ``bound`` are those of all their corners together.
        corners: What the light gives at each of them; None without tolerances.
        notes: What is too coarse for the light to be what it is claimed to be, a sentence each.
    """

    sinogram: DeviceArray
    operator: Operator
    method: Method
    history: tuple[Step, ...]
    window: float
    evaluations: float
    papers: tuple[str, ...]
    seconds: float
    target_name: str
    state: dict[str, Any] = field(default_factory=dict, repr=False)
    best_iteration: int = 0
    bound: Bound | None = None
    target: Any = field(default=None, repr=False)
    tolerances: Tolerances | None = None
    corners: CornerDoses | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        held = "" if self.corners is None else f" at {len(self.corners.corners)} corners"
        after = f"after {self.evaluations:g} evaluations"
        return f"Plan({self.target_name!r}: strict window {self.window:+.4f}{held} {after})"

    def _repr_html_(self) -> str:
        light = self.sinogram.numpy() if drawable(self.sinogram.shape) else None
        numbers = {
            "strict window": f"{self.window:+.4f} of the greatest dose",
            **({} if self.corners is None else {"nominal window": f"{self.corners.nominal:+.4f}"}),
            "method": getattr(self.method, "name", type(self.method).__name__),
            "iterations": f"{len(self.history)}, the best after {self.best_iteration}",
            "evaluations of the projector": f"{self.evaluations:g}",
            "took": f"{self.seconds:.3g} s by {self.ran}",
            "light [angle, r, z]": " × ".join(f"{n:,}" for n in self.sinogram.shape),
        }
        planes: dict[str, np.ndarray | None] = {
            "light of the first angle, r × z": None if light is None else light[0],
            "light of the middle row, r × angle": None if light is None else light[:, :, light.shape[2] // 2].T,
        }
        return card(f"Plan of {self.target_name!r}", numbers, planes)

    @property
    def ran(self) -> str:
        """The operator and the device that found the light, in words."""
        layers: list[Any] = [self.operator]
        while isinstance(layers[-1], Defocused):
            layers.append(layers[-1].operator)
        return f"{' '.join(type(each).__name__ for each in layers)} on {self.operator.device.name}"

    @cached_property
    def idle_light(self) -> float:
        """Share of the light in pixels whose rays never meet the part; NaN where nobody said what is printed.

        One forward projection.
        """
        if self.target is None:
            return float("nan")
        lit = lit_pixels(self.operator, on_device(self.operator, self.target))
        return idle_light(self.operator, self.sinogram, lit)

    def dose(self) -> DeviceArray:
        """Dose [x, y, z] of the light on the operator's device: Aᵀ sinogram."""
        return self.operator.T(self.sinogram)

    def save(self, path: str | Path, *, state: bool = True, overwrite: bool = False) -> Path:
        """Write a job folder that `vamgpu.load` reads, and that ``vam prove`` and ``vam print`` take.

        Args:
            path: The folder.
            state: Keep what resuming needs too, several times as much as the light.
            overwrite: Replace a job folder that stands there.

        Returns:
            The path.

        Raises:
            BadInput: Nothing but Python can describe the operator.
            StorageError: The path is taken, or cannot be written.
        """
        # a circle: folders make plans
        from vamgpu.methods.plan_folder import save_plan

        return save_plan(self, path, state=state, overwrite=overwrite)


def copied(value: Any) -> Any:
    """A copy of what a plan remembers, arrays included, so that the plan stays what it is."""
    if isinstance(value, DeviceArray):
        return combine(1.0, value, 0.0, value, value.device.empty(value.shape))
    if isinstance(value, dict):
        return {name: copied(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(copied(part) for part in value)
    return value
