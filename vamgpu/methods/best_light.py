"""The best light that a run has evaluated, stored in the run's memory."""

from __future__ import annotations

from math import inf, isfinite
from typing import TYPE_CHECKING, Any

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.loss import Loss
from vamgpu.methods.method import Criterion
from vamgpu.operators.compose import combine

if TYPE_CHECKING:
    from vamgpu.methods.state import OptimizerState


class Best:
    """It needs one more sinogram of memory and no time: methods offer light whose dose they have computed anyway."""

    memory: dict[str, Any]

    def __init__(self, memory: dict[str, Any], criterion: Criterion) -> None:
        self.memory, self.criterion = memory, criterion
        self.unseen: Loss | None = None  # that of ``light`` in memory if it has not been evaluated yet

    def better(self, loss: float, window: float) -> bool:
        """Whether light of this loss and strict window is better than the stored light, and both are finite."""
        if not (isfinite(loss) and isfinite(window)):
            return False
        return window > self.window if self.criterion == "window" else loss < self.loss

    def offer(self, light: DeviceArray, loss: float, window: float, iteration: int) -> bool:
        """Copy the light if it is better than the stored light."""
        self.unseen = None
        if not self.better(loss, window):
            return False
        if "best" not in self.memory:
            self.memory["best"] = light.device.empty(light.shape)
        combine(1.0, light, 0.0, light, self.memory["best"], floor=0.0)
        self.memory.update({"best loss": loss, "best window": window, "best iteration": iteration})
        return True

    @property
    def loss(self) -> float:
        """Loss of the stored light; infinite without one."""
        return float(self.memory.get("best loss", inf))

    @property
    def window(self) -> float:
        """Strict window of the stored light; −infinity without one."""
        return float(self.memory.get("best window", -inf))

    @property
    def iteration(self) -> int:
        """Number of iterations after which the stored light was reached."""
        return int(self.memory.get("best iteration", 0))

    def choose(self, state: OptimizerState) -> tuple[DeviceArray, float, int]:
        """The light to return; takes at most one more evaluation, and none if all light was offered."""
        kept = self.memory.get("best")
        if kept is not None and self.unseen is None:
            return kept, self.window, self.iteration
        last = state.buffer("light")
        dose = state.operator.T(last)
        window, _ = state.window(dose)
        loss = state.loss(dose, self.unseen) if self.unseen is not None and self.criterion == "loss" else 0.0
        if kept is None or self.better(loss, window):
            return last, window, state.iteration
        return kept, self.window, self.iteration
