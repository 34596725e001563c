"""The loss of a dose made by light of both colors; `minimize` minimizes it over both at once."""

from __future__ import annotations

from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.loss import Loss
from vamgpu.methods.dual.colors import Pair
from vamgpu.methods.minimize import Channel
from vamgpu.methods.state import OptimizerState


class ColorObjective:
    """The loss of a model's dose; the model has ``expose`` and ``gradient``, and there is a channel for each color."""

    # The point that momentum extrapolates is also clipped at 0: every dose is then that of possible light.

    def __init__(self, model: Any, channels: tuple[Channel, ...], loss: Loss) -> None:
        self.model: Any = model
        self.channels: tuple[Channel, ...] = channels
        self.state: OptimizerState = channels[0].state
        self.loss: Loss = loss.on(self.state.field)

    @property
    def light(self) -> Pair:
        """The light with the least loss so far, or the first light."""
        return Pair(*(channel.state.memory.get("best", channel.light) for channel in self.channels))

    @property
    def ahead(self) -> Pair:
        """The light extrapolated by momentum, at which the loss is evaluated."""
        return Pair(*(channel.ahead for channel in self.channels))

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        self._dose = self.model.expose(self.ahead)
        window, _ = self.state.window(self._dose)
        return self.state.loss(self._dose, self.loss), window

    def gradient(self) -> tuple[DeviceArray, ...]:
        return self.model.gradient(self._dose)
