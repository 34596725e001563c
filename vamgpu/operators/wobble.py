"""Position of the axis of rotation at every angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Turntable
from vamgpu.schema.quantities import Place, numeric


@dataclass(frozen=True, init=False, eq=False)
class Wobble:
    """The position of the axis at every angle, in fixed coordinates.

    Parallel light in air is the same along its whole path, and only ``across`` matters for it; ``along`` counts if
    light spreads, is absorbed or casts shadows.

    Args:
        across: Position across the light, towards +r [mm]; one number, or one for every angle, (angles,).
        along: Position along the light [mm]; one number, or one for every angle, (angles,).

    Raises:
        BadInput: A number is not finite.
    """

    across: np.ndarray
    along: np.ndarray

    def __init__(
        self, across: Place | Sequence[Place] | np.ndarray = 0.0, along: Place | Sequence[Place] | np.ndarray = 0.0
    ) -> None:
        for name, values in (("across", across), ("along", along)):
            numbers = numeric(f"Wobble {name}", values, (0, 1), "one finite number [mm] for every angle").copy()
            numbers.setflags(write=False)
            object.__setattr__(self, name, numbers)

    @staticmethod
    def circle(radius: float, phase: float, motion: Turntable) -> Wobble:
        """An axis on a circle, once per turn, if the part was not centered on the turntable.

        Args:
            radius: Distance of the axis from the table's center [mm].
            phase: Direction of the axis from the table's center, measured from x [rad].
            motion: Angles of the turntable.

        Returns:
            The positions of the axis.
        """
        turn = motion.poses - phase
        return Wobble(-radius * np.sin(turn), -radius * np.cos(turn))

    def places(self, poses: int) -> np.ndarray:
        """Positions of the axis at every angle.

        Args:
            poses: Number of angles.

        Returns:
            Across and along [mm], (poses, 2).

        Raises:
            BadInput: The wobble has another number of angles.
        """
        for name, values in (("across", self.across), ("along", self.along)):
            if values.ndim and len(values) != poses:
                raise BadInput(f"Wobble {name} has {len(values)} values; expected one for each of {poses} angles")
        return np.stack([np.broadcast_to(v, (poses,)) for v in (self.across, self.along)], axis=1)


def check_reach(places: np.ndarray, beam: Beam) -> None:
    """Raise `BadInput` if an axis at some places [mm] leaves a beam."""
    far, half = float(np.abs(places).max(initial=0.0)), 0.5 * beam.pixels[0] * beam.pitch
    if far >= half:
        raise BadInput(f"the wobble moves the axis by up to {far:.4g} mm, but the beam reaches {half:.4g} mm to either "
                       "side; expected less: check the wobble's unit, mm")  # fmt: skip
