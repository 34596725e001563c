"""What every linear operator is: two spaces, a device, an action and its exact transpose."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.operators.space import Space, require


class LinearOperator(ABC):
    """Maps ``domain`` to ``range`` on a device. NumPy in → NumPy out; device array in → device array out."""

    domain: Space
    range: Space
    device: Device

    @abstractmethod
    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        """out = A x, both on the device."""

    @abstractmethod
    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        """out = Aᵀ y, both on the device."""

    @property
    @abstractmethod
    def T(self) -> LinearOperator:  # noqa: N802 - the mathematician's name
        """The plain ℓ² transpose; ``A.T.T is A``."""

    @final
    def __call__(self, x: Any, out: DeviceArray | None = None) -> Any:
        """A x for an array of ``domain.shape``; into ``out`` if given. Raises `ShapeMismatch`, `DeviceError`."""
        require(self.domain, x, "the operand")
        source = x if isinstance(x, DeviceArray) else self.device.upload(x)
        self.device.check_mine(source)
        target = out if out is not None else self.device.empty(self.range.shape)
        require(self.range, target, "out")
        self.forward(source, target)
        return target if isinstance(x, DeviceArray) or out is not None else target.numpy()

    @final
    def dense(self) -> np.ndarray:
        """The matrix itself, (range size, domain size): for tiny geometries and proofs."""
        columns = np.prod(self.domain.shape)
        unit = np.zeros(self.domain.shape)
        matrix = np.empty((int(np.prod(self.range.shape)), int(columns)))
        for j in range(int(columns)):
            unit.flat[j] = 1.0
            matrix[:, j] = np.asarray(self(unit)).ravel()
            unit.flat[j] = 0.0
        return matrix

    @final
    def prove(self, seed: int = 0) -> float:
        """|⟨Ax, y⟩ − ⟨x, Aᵀy⟩| / (‖Ax‖‖y‖) for seeded signed normals, sums in float64: 0 for an exact transpose."""
        rng = np.random.default_rng(seed)
        x = rng.standard_normal(self.domain.shape).astype(np.float32)
        y = rng.standard_normal(self.range.shape).astype(np.float32)
        image, shadow = np.asarray(self(x), np.float64), np.asarray(self.T(y), np.float64)
        gap = abs(np.vdot(image, y.astype(np.float64)) - np.vdot(x.astype(np.float64), shadow))
        return float(gap / (np.linalg.norm(image) * np.linalg.norm(y.astype(np.float64))))


@final
class Transposed(LinearOperator):
    """The transpose of an operator; shares its tables."""

    def __init__(self, operator: LinearOperator) -> None:
        self._operator = operator
        self.domain, self.range, self.device = operator.range, operator.domain, operator.device

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self._operator.transposed(x, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._operator.forward(y, out)

    @property
    def T(self) -> LinearOperator:  # noqa: N802
        return self._operator
