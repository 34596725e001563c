"""The dose by which frames are judged, as an operator."""

from __future__ import annotations

from typing import final

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.projection import Projection
from vamgpu.operators.space import SinogramSpace, VolumeSpace
from vamgpu.printing.independent_exposure import IndependentExposure


@final
class ProofDose(LinearOperator):
    """Map light [angle, r, z] to the dose that `simulate` judges, traced independently of the operator on finer voxels.

    The transpose is exact but computed on the host in float64: at 128³ voxels and 360 angles it takes minutes.

    Args:
        A: Gives the geometry; its tables are not used.

    Raises:
        BadInput: ``A`` is no `Projection`, or no ray reaches the resin.
    """

    domain: SinogramSpace
    range: VolumeSpace
    device: Device

    def __init__(self, A: Projection) -> None:
        if not isinstance(A, Projection):
            raise BadInput(f"got {A!r}; expected a Projection, which independent rays can check")
        self.domain = A.range  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.range = A.domain  # pyright: ignore[reportIncompatibleVariableOverride]
        self.device = A.device
        self._exposure = IndependentExposure(A)

    def __repr__(self) -> str:
        return f"ProofDose({self.domain!r} → {self.range!r})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        for _ in self._exposure.onto(x, out):
            pass

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.device.put(self._exposure.back(y.numpy()), out)
