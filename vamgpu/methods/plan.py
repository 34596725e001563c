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
        loss: The method's own loss. It is that of the current light if the loss selects the best light; otherwise that
            of the evaluated point, which accelerated methods place ahead of the current light.
        window: Strict process window of the current light, (least dose in the part − greatest outside) / greatest; −1
            for light without any dose.
    """

    iteration: int
    evaluations: float
    loss: float
    window: float


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """Patterns that print a target: the best that a run evaluated, not its last.

    The best patterns have the greatest strict window or the lowest loss, depending on the method's ``criterion``.

    Attributes:
        sinogram: Patterns [angle, r, z] ≥ 0 on the operator's device, in units of the dose the part should get.
        operator: The projector that they were found for.
        method: The method that found them.
        history: One `Step` per iteration.
        window: Strict process window of these patterns, a share of the greatest dose.
        evaluations: Projector evaluations that the method spent. Not counted are one at the start, which checks whether
            light reaches the part, and half of one at the end, which selects the patterns.
        papers: Papers of the method.
        seconds: Wall time of the run [s].
        target_name: Name of the target.
        state: Memory for resuming; a resumed run continues from its last patterns, not from the best.
        best_iteration: Number of iterations after which these patterns were reached; 0 means the initial patterns.
        bound: Upper bound on the window, if the method gives one; otherwise see `vamgpu.methods.bound`.
        target: The target given to `optimize`; None if unknown.
        tolerances: Tolerances of the run; ``window`` and ``bound`` are those of all their corners together.
        corners: Doses of the patterns at each corner; None without tolerances.
        notes: Warnings about voxels or angles too coarse for the predicted result, one sentence each.
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
        """Share of the light in pixels whose rays never meet the part; NaN if the target is unknown.

        One forward projection.
        """
        if self.target is None:
            return float("nan")
        lit = lit_pixels(self.operator, on_device(self.operator, self.target))
        return idle_light(self.operator, self.sinogram, lit)

    def dose(self) -> DeviceArray:
        """Dose [x, y, z] of the patterns on the operator's device: Aᵀ sinogram."""
        return self.operator.T(self.sinogram)

    def save(self, path: str | Path, *, state: bool = True, overwrite: bool = False) -> Path:
        """Write a job folder for `vamgpu.load`, ``vam prove`` and ``vam print``.

        Args:
            path: The folder.
            state: Also store the memory for resuming, which is several times the size of the patterns.
            overwrite: Replace an existing job folder.

        Returns:
            The path.

        Raises:
            BadInput: A folder cannot describe the operator.
            StorageError: The path exists, or cannot be written.
        """
        # avoids a circular import: folders make plans
        from vamgpu.methods.plan_folder import save_plan

        return save_plan(self, path, state=state, overwrite=overwrite)


def copied(value: Any) -> Any:
    """A copy of a plan's memory, including its arrays; the plan then does not change."""
    if isinstance(value, DeviceArray):
        return combine(1.0, value, 0.0, value, value.device.empty(value.shape))
    if isinstance(value, dict):
        return {name: copied(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(copied(part) for part in value)
    return value
