"""Operators for runs of neighboring angles of a turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.geometry import Turntable
from vamgpu.kernels.inhibition import put_poses, take_poses
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.projection import Projection


class PoseRuns:
    """A turn cut into runs of neighboring angles; only a `Projection` is cut itself. Raises `BadInput`."""

    def __init__(self, operator: LinearOperator, count: int) -> None:
        motion = getattr(operator, "motion", None)
        if not isinstance(operator, LinearOperator) or not isinstance(motion, Turntable):
            raise BadInput(f"got {operator!r}; expected a projector whose turn can be cut into runs of angles")
        angles = motion.angles
        if isinstance(count, bool) or int(count) != count or not 1 <= count <= angles:
            raise BadInput(f"runs is {count!r} in a turn of {angles} angles; expected a whole number of 1 to {angles}")
        runs = np.array_split(np.arange(angles), int(count))
        self.whole: Any = operator
        self.first: tuple[int, ...] = tuple(int(run[0]) for run in runs)
        self.parts: tuple[Projection, ...] = ()
        if isinstance(operator, Projection):
            self.parts = tuple(operator.turned(motion.chosen(run.tolist())) for run in runs)
        self._shapes = [(len(run), *operator.range.shape[1:]) for run in runs]

    def __len__(self) -> int:
        return len(self.first)

    def expose(self, run: int, light: DeviceArray, out: DeviceArray) -> None:
        """out = dose [x, y, z] of one run of angles of a turn's light [angle, r, z]."""
        device, first = self.whole.device, self.first[run]
        rows = device.empty(self._shapes[run])
        device.launch(take_poses, light=light, first=first, part=rows)
        if self.parts:
            self.parts[run].T(rows, out=out)
            return
        alone = device.upload(np.zeros(self.whole.range.shape, np.float32))
        device.launch(put_poses, part=rows, first=first, light=alone)
        self.whole.T(alone, out=out)

    def project(self, run: int, volume: DeviceArray, light: DeviceArray) -> None:
        """Write the projection of a volume [x, y, z] into the angles of a run."""
        device, first = self.whole.device, self.first[run]
        rows = device.empty(self._shapes[run])
        if self.parts:
            self.parts[run](volume, out=rows)
        else:
            device.launch(take_poses, light=self.whole(volume), first=first, part=rows)
        device.launch(put_poses, part=rows, first=first, light=light)
