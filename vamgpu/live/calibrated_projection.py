"""A projector as estimated: its light is moved, and its dose is multiplied by a gain that varies slowly."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.update import multiply
from vamgpu.operators.compose import Derived, inherit
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.shifts import Shift
from vamgpu.operators.space import require


@final
class CalibratedProjection(Derived):
    """Dose gain·Aᵀ(light moved by ``height`` and ``across`` [mm], linearly between pixels), and its transpose."""

    operator: LinearOperator
    height: float
    across: float

    def __init__(self, operator: LinearOperator, gain: Any, height: float = 0.0, across: float = 0.0) -> None:
        require(operator.domain, gain, "the gain")
        self.operator, self.height, self.across = operator, float(height), float(across)
        self._set_spaces(operator.domain, operator.range, operator.device)
        inherit(self, operator)
        self.gain: DeviceArray = gain if isinstance(gain, DeviceArray) else self.device.upload(gain)
        self._shift = None
        if height or across:
            moves = np.tile(np.array([-across, height]) / self.beam.pitch, (self.range.shape[0], 1))
            self._shift = Shift(self.device, moves, self.beam.pixels, self.beam.pixels)
            self._tapers = self.device.table(np.ones((1, self.beam.pixels[1])))

    def __repr__(self) -> str:
        return f"CalibratedProjection({self.operator!r}, height={self.height:g}, across={self.across:g})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        weighted = self._work("weighted", self.domain.shape)
        self.device.launch(multiply, x=x, y=self.gain, out=weighted)
        still = out if self._shift is None else self._work("light", self.range.shape)
        self.operator.forward(weighted, still)
        if self._shift is not None:
            self._shift.there(still, self._tapers, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        moved = y
        if self._shift is not None:
            moved = self._work("light", self.range.shape)
            self._shift.back(y, self._tapers, moved)
        self.operator.transposed(moved, out)
        self.device.launch(multiply, x=out, y=self.gain, out=out)
