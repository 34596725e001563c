"""Rays bend between the faces of a film whose index varies in space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.optics.index_field import FormulaField, FunctionField, GridField, IndexField
from vamgpu.optics.inputs import Floats
from vamgpu.schema import check
from vamgpu.schema.quantities import Length

NUDGE = 1e-4  # half the distance [mm] of the finite difference for the gradient of the index


@dataclass(frozen=True)
class FilmIndex:
    """Refractive index of the resin on the wrapped film, in the fixed frame of one angle.

    Args:
        index: A medium in x and y [mm], with the roller's axis at (0, 0): a formula, a grid or a function with a
            region, all of which are marched on a device; or a plain function of arrays x and y, which is traced in
            NumPy and evaluated up to `NUDGE` mm outside the film. Job folders can store only formulas and grids.
        stride: Longest straight segment [mm]; errors fall with its square.

    Raises:
        BadInput: A value is out of its range, or the medium depends on z.
    """

    index: FormulaField | GridField | FunctionField | Callable[[Floats, Floats], Floats]
    stride: Length = 0.05

    def __post_init__(self) -> None:
        check(self)
        if isinstance(self.index, (FormulaField, GridField, FunctionField)):
            if isinstance(self.index, FormulaField):
                deep = self.index.weights[2] != 0.0
            else:
                deep = (self.index.coefficients.ndim if isinstance(self.index, GridField) else self.index.axes) > 2
            if deep:
                raise BadInput(f"FilmIndex index is a {type(self.index).__name__} that depends on z; expected one of "
                               "x and y, because all rows of a web share the light of one angle")  # fmt: skip
        elif not callable(self.index):
            raise BadInput(f"FilmIndex index is {self.index!r}; expected a FormulaField, a GridField, a FunctionField, "
                           "or a function of x and y [mm]")  # fmt: skip

    @property
    def medium(self) -> IndexField | None:
        """The field for the marching kernels; None for a plain function."""
        return self.index if isinstance(self.index, (FormulaField, GridField, FunctionField)) else None

    def check_reach(self, outer: float, leg: float) -> None:
        """Raise `BadInput` unless the medium is known in all of a film of an outer radius with straight runs [mm]."""
        if isinstance(self.index, GridField):
            corner, shape = self.index.corner, self.index.coefficients.shape
            spans = [(low, low + (n - 3) * self.index.pitch) for low, n in zip(corner, shape, strict=False)]
        elif isinstance(self.index, FunctionField):
            spans = list(self.index.region.extents[:2])
        else:
            return
        need, slack = ((-outer, outer), (-outer, leg)), 1e-6 * outer
        if any(low > a + slack or high < b - slack for (low, high), (a, b) in zip(spans, need, strict=True)):
            known, needed = (" and ".join(f"{low:.4g} to {high:.4g}" for low, high in s) for s in (spans, need))
            raise BadInput(f"the {type(self.index).__name__} of the film covers {known} mm in x and y; expected "
                           f"{needed} mm, the film with its straight runs")  # fmt: skip

    def at(self, x: Floats, y: Floats) -> Floats:
        """Index at given positions; raises `BadInput` if it is below 1 or not finite."""
        if (medium := self.medium) is not None:
            square = medium.evaluate(np.stack([x, y, np.zeros_like(x)], axis=1))[1]
            return self._checked(np.sqrt(np.maximum(square, 0.0)), x)
        assert callable(self.index)
        return self._checked(self.index(x, y), x)

    @staticmethod
    def _checked(index: Floats, x: Floats) -> Floats:
        found = np.broadcast_to(np.asarray(index, dtype=np.float64), x.shape)
        if not np.all(found >= 1.0) or not np.all(np.isfinite(found)):
            raise BadInput(
                f"the index of the resin is {np.min(found):g} to {np.max(found):g} along the rays; expected "
                "finite numbers of at least 1"
            )
        return found

    def slope(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Gradient [1/mm]."""
        east, north = self.at(x + NUDGE, y) - self.at(x - NUDGE, y), self.at(x, y + NUDGE) - self.at(x, y - NUDGE)
        return east / (2.0 * NUDGE), north / (2.0 * NUDGE)

    def kick(self, rays: dict[str, Any], way: Floats, strength: Floats) -> Floats:
        """Turn rays in the film by the gradient at their position over a distance [mm]; returns the new strength.

        strength: length of index × direction. Half a turn, a straight path and half a turn are one step of the
        second-order symplectic scheme for d(n·d)/ds = ∇n.
        """
        east, north = self.slope(rays["x"], rays["y"])
        pull = np.where(rays["film"], way, 0.0)
        px, py = strength * rays["dx"] + pull * east, strength * rays["dy"] + pull * north
        new = np.hypot(px, py)
        rays["dx"], rays["dy"] = px / new, py / new
        return new
