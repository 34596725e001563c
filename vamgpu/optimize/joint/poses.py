"""A turn of a projector, in short runs of poses one after another."""

from __future__ import annotations

from copy import copy

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.geometry import Turntable
from vamgpu.kernels.inhibition import put_poses, take_poses
from vamgpu.operators.linear import Transposed
from vamgpu.operators.projection import Projection
from vamgpu.operators.space import SinogramSpace


class PoseRuns:
    """The operator of every run of poses; runs differ by one pose at most.

    operator: of the whole turn.  count: of runs.  Raises `BadInput` for fewer poses than runs.
    """

    def __init__(self, operator: Projection, count: int) -> None:
        if not isinstance(operator, Projection):
            raise BadInput(f"got {operator!r}; wanted a Projection, which can be cut into runs of poses")
        angles = operator.motion.angles
        if isinstance(count, bool) or int(count) != count or not 1 <= count <= angles:
            raise BadInput(f"{count!r} runs of {angles} poses; wanted a whole number of 1 to {angles}")
        poses = np.array_split(operator.motion.poses, int(count))
        self.whole = operator
        self.first = tuple(int(n) for n in np.cumsum([0, *map(len, poses)])[:-1])
        self.parts = tuple(_part(operator, angles) for angles in poses)

    def __len__(self) -> int:
        return len(self.parts)

    def expose(self, run: int, light: DeviceArray, out: DeviceArray) -> None:
        """out = dose of one run of poses of the light of a turn."""
        device, part = self.whole.device, self.parts[run]
        rows = device.empty(part.range.shape)
        device.launch(take_poses, light=light, first=self.first[run], part=rows)
        part.T(rows, out=out)

    def project(self, run: int, volume: DeviceArray, light: DeviceArray) -> None:
        """The transpose, into the poses of that run; the others stay as they are."""
        device, part = self.whole.device, self.parts[run]
        rows = device.empty(part.range.shape)
        part(volume, out=rows)
        device.launch(put_poses, part=rows, first=self.first[run], light=light)


def _part(operator: Projection, poses: np.ndarray) -> Projection:
    """The operator at some poses alone; it shares the tables of one pose."""
    part = copy(operator)
    vars(part).pop("_slices", None)
    part.motion = Turntable(len(poses))
    part.range = SinogramSpace(operator.beam, part.motion)
    part._directions = operator.device.table(np.stack([np.cos(poses), np.sin(poses)], axis=1))
    part._transpose = Transposed(part)
    return part
