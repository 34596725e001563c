"""A field and the two classes of its samples."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, ShapeMismatch

OUT, IN = 0, 1
"""Classes: outside the part, in the part."""

EVERYWHERE = 1e18


@dataclass(frozen=True, eq=False)
class Parts:
    """A dose, and the voxels in the part: their target is ``level`` or more. Raises `ShapeMismatch`, `BadInput`."""

    dose: DeviceArray  # [x, y, z]
    target: DeviceArray  # [x, y, z] on the same device
    level: float = 0.5  # fraction from which a voxel counts as in
    reach: float | None = None  # radius that is counted [voxels]; None, the default everywhere, for the inscribed one

    def __post_init__(self) -> None:
        if self.dose.shape != self.target.shape or len(self.dose.shape) != 3:
            raise ShapeMismatch(
                f"the dose has shape {self.dose.shape}, the target {self.target.shape}; "
                "expected the same [x, y, z]: build both on one grid"
            )
        self.dose.device.check_mine(self.target)
        if self.reach is None:
            object.__setattr__(self, "reach", 0.5 * (min(self.dose.shape[:2]) - 1))
        elif not self.reach >= 0:
            raise BadInput(f"reach is {self.reach!r} voxels; expected a number ≥ 0, or None for the inscribed cylinder")

    @classmethod
    def whole(cls, field: DeviceArray) -> Parts:
        """Every sample of a field [x, y, z] in class `IN`, e.g. of a sinogram."""
        return cls(field, field, level=-EVERYWHERE, reach=EVERYWHERE)
