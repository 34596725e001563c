"""Two colors of light for a resin, and their patterns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.operators.compose import combine
from vamgpu.operators.linear import LinearOperator


class Pair(NamedTuple):
    """A field of each color.

    Args:
        visible, ultraviolet: Sinograms [angle, r, z], or volumes [x, y, z].
    """

    visible: DeviceArray
    ultraviolet: DeviceArray


def subtracted(operators: tuple[Any, Any], gains: tuple[float, float], light: Pair) -> DeviceArray:
    """Dose a·A_visᵀ light + b·A_uvᵀ light [x, y, z] for gains (a, b)."""
    dose, undone = (A.T(part) for A, part in zip(operators, light, strict=True))
    return combine(gains[0], dose, gains[1], undone, dose)


def subtracted_gradient(operators: tuple[Any, Any], gains: tuple[float, float], slope: DeviceArray) -> Pair:
    """Derivatives by the light of `subtracted` from those by its dose."""
    slopes = [A(slope) for A in operators]
    return Pair(*(combine(gain, values, 0.0, values, values) for gain, values in zip(gains, slopes, strict=True)))


@dataclass(frozen=True, eq=False)
class Colors:
    """One volume, lit by light that cures (visible) and by light that inhibits (UV).

    Args:
        visible, uv: Operators of the two colors on one grid, one set of angles and one device, each with the absorption
            of its color. ``.T`` maps light of the color to dose and is the exact transpose.
        projector: Operator that projects doses to light in rules with passes, for example one without absorption;
            None for each color's own.
        strength: Visible dose that one unit of UV dose cancels.
        whole: Every voxel of the grid counts, for example in a square slice whose diagonal is the diameter. Otherwise,
            methods that use it count only the inscribed cylinder.

    Raises:
        BadInput: A value is out of its range.
        ShapeMismatch: Shapes do not fit.
    """

    visible: LinearOperator
    uv: LinearOperator
    projector: LinearOperator | None = None
    strength: float = 1.0
    whole: bool = False

    def __post_init__(self) -> None:
        for name, other in (("uv", self.uv), ("projector", self.projector or self.visible)):
            if (other.domain.shape, other.range.shape) != (self.visible.domain.shape, self.visible.range.shape):
                raise ShapeMismatch(
                    f"{name} maps {other.domain.shape} to {other.range.shape}, visible {self.visible.domain.shape} to "
                    f"{self.visible.range.shape}; expected the same: build both on one grid, beam and motion"
                )
            motion, poses = (getattr(one, "motion", None) for one in (other, self.visible))
            if motion != poses:
                raise BadInput(f"{name} has {motion!r}, visible {poses!r}; expected the same angles for both colors")
            if other.device is not self.visible.device:
                raise BadInput(f"{name} is on {other.device}, visible on {self.visible.device}; expected one device")
        if not 0.0 < self.strength < float("inf"):
            raise BadInput(f"strength is {self.strength!r}; expected a finite number > 0")

    def dose(self, visible: DeviceArray, uv: DeviceArray | None) -> DeviceArray:
        """Visible dose − strength · UV dose [x, y, z], on the device.

        Args:
            visible, uv: Sinograms [angle, r, z] on the device; None for no UV light.

        Returns:
            Visible dose − strength · UV dose [x, y, z], on the device.
        """
        return self.visible.T(visible) if uv is None else self.expose(Pair(visible, uv))

    def expose(self, light: Pair) -> DeviceArray:
        """Compute the dose of both colors, as `dose` does.

        Args:
            light: Sinograms [angle, r, z] of both colors.

        Returns:
            Dose [x, y, z].
        """
        return subtracted((self.visible, self.uv), (1.0, -self.strength), light)

    def gradient(self, slope: DeviceArray) -> Pair:
        """Compute derivatives with respect to the light from those with respect to the dose.

        Args:
            slope: Derivatives with respect to the dose [x, y, z].

        Returns:
            Derivatives with respect to the light [angle, r, z] of both colors.
        """
        return subtracted_gradient((self.visible, self.uv), (1.0, -self.strength), slope)


@dataclass(frozen=True)
class Pass:
    """One record of a run.

    Args:
        number: Number of the pass, from 1.
        evaluations: Projector evaluations so far, both colors.
        undersupply, oversupply: Root mean squares over all voxels; doses in units of the design.
    """

    number: int
    evaluations: float
    undersupply: float
    oversupply: float

    @property
    def error(self) -> float:
        """Root mean square of buildup − design."""
        return (self.undersupply**2 + self.oversupply**2) ** 0.5


@dataclass(frozen=True, eq=False, repr=False)
class DualPlan:
    """Light of two colors for one design.

    Args:
        visible, uv: Sinograms [angle, r, z] ≥ 0 on the device, scaled so that the buildup is in units of the design; uv
            is None for methods of one color.
        colors, method: The colors and the method of the run.
        history: One `Pass` per pass.
        seconds: Wall time of the run [s].
        papers: Papers of the method.
    """

    visible: DeviceArray
    uv: DeviceArray | None
    colors: Colors
    method: Any
    history: tuple[Pass, ...]
    seconds: float
    papers: tuple[str, ...]

    def __repr__(self) -> str:
        name = type(self.method).__name__
        return f"DualPlan({name}: {len(self.history)} passes, {self.history[-1]!r}, {self.seconds:.3g} s)"

    def dose(self) -> DeviceArray:
        """Effective dose [x, y, z] on the device by the method's model: usually visible dose − strength · UV dose."""
        if self.uv is None:
            return self.colors.dose(self.visible, None)
        return self.method.dose(self.colors, Pair(self.visible, self.uv))


def constant(value: float, shape: tuple[int, int, int], like: DeviceArray) -> DeviceArray:
    """A field of one value, of ``shape``, on the device of ``like``."""
    import numpy as np

    return like.device.upload(np.full(shape, value, np.float32))
