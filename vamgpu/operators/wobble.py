"""Where the axis of rotation stands at every pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Turntable
from vamgpu.schema.quantities import Place


@dataclass(frozen=True, init=False, eq=False)
class Wobble:
    """The place of the axis at every angle, in the laboratory.

    Parallel light in air is the same all along its way, so only ``across`` matters to it; ``along`` counts where light
    spreads, is absorbed or casts shadows.

    Args:
        across: Across the light, towards +r [mm]; one number, or one for every angle, (angles,).
        along: Along the light [mm]; one number, or one for every angle, (angles,).

    Raises:
        BadInput: A number is not finite.
    """

    across: np.ndarray
    along: np.ndarray

    def __init__(
        self, across: Place | Sequence[Place] | np.ndarray = 0.0, along: Place | Sequence[Place] | np.ndarray = 0.0
    ) -> None:
        for name, values in (("across", across), ("along", along)):
            numbers = np.array(values, np.float64)
            if numbers.ndim > 1 or not np.isfinite(numbers).all():
                raise BadInput(f"Wobble {name} has shape {numbers.shape} and {np.count_nonzero(~np.isfinite(numbers))} "
                               "values that are not finite; expected one finite number [mm] for every "
                               "angle")  # fmt: skip
            numbers.setflags(write=False)
            object.__setattr__(self, name, numbers)

    @staticmethod
    def circle(radius: float, phase: float, motion: Turntable) -> Wobble:
        """An axis that runs round once a turn: the part was not centered on the turntable.

        Args:
            radius: Distance from the table's center of the point that carries the axis [mm].
            phase: Direction of that point from x [rad].
            motion: Angles of the turntable.

        Returns:
            The places of the axis.
        """
        turn = motion.poses - phase
        return Wobble(-radius * np.sin(turn), -radius * np.cos(turn))

    def places(self, poses: int) -> np.ndarray:
        """Where the axis stands at every angle.

        Args:
            poses: How many angles there are.

        Returns:
            Across and along [mm], (poses, 2).

        Raises:
            BadInput: The wobble is that of another number of angles.
        """
        for name, values in (("across", self.across), ("along", self.along)):
            if values.ndim and len(values) != poses:
                raise BadInput(f"Wobble {name} has {len(values)} values; expected one for each of {poses} angles")
        return np.stack([np.broadcast_to(v, (poses,)) for v in (self.across, self.along)], axis=1)
