"""The dose by which frames are judged, as an operator."""

from __future__ import annotations

from typing import final

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.projection import Projection
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.travel import at_rest


@final
class ProofDose(LinearOperator):
    """Map light [angle, r, z] to the dose that `simulate` judges, traced independently of the operator on finer voxels.

    The transpose is exact but computed on the host in float64: at 128³ voxels and 360 angles it takes minutes.

    Args:
        A: Gives the geometry; its tables are not used.

    Raises:
        BadInput: ``A`` is no `Projection`, no ray reaches the resin, or the part travels.
    """

    def __init__(self, A: Projection) -> None:
        if not isinstance(A, Projection):
            raise BadInput(f"got {A!r}; expected a Projection, which independent rays can check")
        at_rest("ProofDose", A.motion)
        self._set_spaces(A.range, A.domain, A.device)
        self._exposure = IndependentExposure(A)

    def __repr__(self) -> str:
        return f"ProofDose({self.domain!r} → {self.range!r})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        for _ in self._exposure.onto(x, out):
            pass

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.device.put(self._exposure.back(y.numpy()), out)
