"""A turn of a projector, in short runs of poses one after another."""

from __future__ import annotations

from copy import copy

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.geometry import Turntable
from vamgpu.kernels.inhibition import put_poses, take_poses
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.linear import Transposed
from vamgpu.operators.projection import Projection
from vamgpu.operators.space import SinogramSpace


class PoseRuns:
    """The operator of every run of poses; runs differ by one pose at most.

    Args:
        operator: Of the whole turn.
        count: Of runs.

    Raises:
        BadInput: For fewer poses than runs.
    """

    def __init__(self, operator: Projection, count: int) -> None:
        if not isinstance(operator, Projection):
            raise BadInput(f"got {operator!r}; expected a Projection, which can be cut into runs of poses")
        angles = operator.motion.angles
        if isinstance(count, bool) or int(count) != count or not 1 <= count <= angles:
            raise BadInput(f"{count!r} runs of {angles} poses; expected a whole number of 1 to {angles}")
        runs = np.array_split(np.arange(angles), int(count))
        self.whole = operator
        self.first: tuple[int, ...] = tuple(int(run[0]) for run in runs)
        self.parts: tuple[Projection, ...] = tuple(
            _part(operator, operator.motion.part(int(run[0]), int(run[-1]) + 1)) for run in runs
        )

    def __len__(self) -> int:
        return len(self.parts)

    def expose(self, run: int, light: DeviceArray, out: DeviceArray) -> None:
        """Compute out = dose of one run of poses of the light of a turn.

        Args:
            run: Number of the run.
            light: Sinogram [angle, r, z] of the turn.
            out: Takes the dose [x, y, z].
        """
        device, part = self.whole.device, self.parts[run]
        rows = device.empty(part.range.shape)
        device.launch(take_poses, light=light, first=self.first[run], part=rows)
        part.T(rows, out=out)

    def project(self, run: int, volume: DeviceArray, light: DeviceArray) -> None:
        """Compute the transpose, into the poses of that run; the others stay as they are.

        Args:
            run: Number of the run.
            volume: Volume [x, y, z].
            light: Takes the projection [angle, r, z].
        """
        device, part = self.whole.device, self.parts[run]
        rows = device.empty(part.range.shape)
        part(volume, out=rows)
        device.launch(put_poses, part=rows, first=self.first[run], light=light)


def _part(operator: Projection, motion: Turntable) -> Projection:
    """The operator at some poses alone; it shares the tables of one pose."""
    part = copy(operator)
    vars(part).pop("_slices", None)
    part.motion, poses = motion, motion.poses
    part.range = SinogramSpace(operator.beam, motion)
    part._directions = operator.device.table(np.stack([np.cos(poses), np.sin(poses)], axis=1))
    part._dwell = Dwell(motion, operator.device)
    part._transpose = Transposed(part)
    return part
