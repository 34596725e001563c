"""A turn of a projector, divided into short runs of angles one after another."""

from __future__ import annotations

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.inhibition import put_poses, take_poses
from vamgpu.operators.projection import Projection


class PoseRuns:
    """The operators of the runs into which the angles of a turn are divided. Raises `BadInput` for too many runs."""

    def __init__(self, operator: Projection, count: int) -> None:
        if not isinstance(operator, Projection):
            raise BadInput(f"got {operator!r}; expected a Projection, which can be cut into runs of angles")
        angles = operator.motion.angles
        if isinstance(count, bool) or int(count) != count or not 1 <= count <= angles:
            raise BadInput(f"{count!r} runs of {angles} angles; expected a whole number of 1 to {angles}")
        runs = np.array_split(np.arange(angles), int(count))
        self.whole = operator
        self.first: tuple[int, ...] = tuple(int(run[0]) for run in runs)
        self.parts: tuple[Projection, ...] = tuple(
            operator.turned(operator.motion.part(int(run[0]), int(run[-1]) + 1)) for run in runs
        )

    def __len__(self) -> int:
        return len(self.parts)

    def expose(self, run: int, light: DeviceArray, out: DeviceArray) -> None:
        """out = dose [x, y, z] of one run of angles of a turn's light [angle, r, z]."""
        device, part = self.whole.device, self.parts[run]
        rows = device.empty(part.range.shape)
        device.launch(take_poses, light=light, first=self.first[run], part=rows)
        part.T(rows, out=out)

    def project(self, run: int, volume: DeviceArray, light: DeviceArray) -> None:
        """Write the projection of a volume [x, y, z] into the angles of a run."""
        device, part = self.whole.device, self.parts[run]
        rows = device.empty(part.range.shape)
        part(volume, out=rows)
        device.launch(put_poses, part=rows, first=self.first[run], light=light)
