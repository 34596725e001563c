"""Light of a projector's gray levels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.schema.quantities import numeric
from vamgpu.storage.reading import load_toml

TOP = 255


@dataclass(frozen=True)
class GrayCurve:
    """Measured light of a projector against its gray levels, linear between the measured ones.

    Args:
        levels: Measured gray levels, rising from 0 to 255.
        intensity: Light at each level, in any unit, never falling; stored relative to that of level 255. The light at
            level 0 is the black level, which may exceed zero because mirrors never close completely.

    Raises:
        BadInput: A value is out of its range.
    """

    levels: tuple[int, ...]
    intensity: tuple[float, ...]

    def __post_init__(self) -> None:
        levels, light = numeric("levels", self.levels), numeric("intensity", self.intensity)
        if len(levels) != len(light) or len(levels) < 2:
            raise BadInput(
                f"a gray curve has {len(levels)} levels and {len(light)} intensities; "
                "expected one intensity per level, at least two"
            )
        if (levels != np.round(levels)).any() or (np.diff(levels) <= 0).any() or (levels[0], levels[-1]) != (0, TOP):
            got = np.array2string(levels, threshold=8, edgeitems=3, separator=", ").replace("\n", "")
            raise BadInput(f"gray levels are {got}; expected whole numbers rising from 0 to {TOP}: measure both ends")
        fall = np.flatnonzero(np.diff(light) < 0)
        if fall.size:
            at = int(fall[0])
            raise BadInput(
                f"intensity falls from {light[at]:g} at level {levels[at]:g} to {light[at + 1]:g} at level "
                f"{levels[at + 1]:g}; expected one that never falls: average more readings"
            )
        if light[0] < 0 or light[-1] <= light[0]:
            raise BadInput(
                f"intensity goes from {light[0]:g} to {light[-1]:g}; expected 0 ≤ black < full-on: "
                "subtract the dark reading"
            )
        object.__setattr__(self, "levels", tuple(int(level) for level in levels))
        object.__setattr__(self, "intensity", tuple(float(value) for value in light / light[-1]))

    @classmethod
    def linear(cls, black: float = 0.0) -> GrayCurve:
        """Make a curve whose light is proportional to the level.

        Args:
            black: Black level, a share of full-on.

        Returns:
            The curve.

        Raises:
            BadInput: The black level is negative or above 1.
        """
        return cls((0, TOP), (positive("black level", black, zero=True), 1.0))

    @classmethod
    def gamma(cls, exponent: float, black: float = 0.0) -> GrayCurve:
        """Make the curve black + (1 − black)·(level / 255)^exponent.

        Args:
            exponent: Exponent of the curve, above 0.
            black: Black level, a share of full-on.

        Returns:
            The curve, given at every level.

        Raises:
            BadInput: A value is out of its range.
        """
        power = positive("gamma exponent", exponent)
        dark = positive("black level", black, zero=True)
        levels = np.arange(TOP + 1)
        return cls(tuple(levels.tolist()), tuple((dark + (1.0 - dark) * (levels / TOP) ** power).tolist()))

    @classmethod
    def load(cls, path: str | Path) -> GrayCurve:
        """Read the table ``[gray]`` of a projector's TOML file: arrays ``levels`` and ``intensity`` of equal length.

        For example ``levels = [0, 64, 128, 192, 255]`` and ``intensity = [0.9, 4.0, 20.0, 61.0, 90.0]``.

        Args:
            path: The TOML file.

        Returns:
            The curve.

        Raises:
            StorageError: The file cannot be read.
            BadInput: The file holds no valid curve.
        """
        file = Path(path)
        table = load_toml(file, "the file of a gray curve").get("gray")
        if not isinstance(table, dict):
            raise BadInput(f"{file.name} has no table [gray]; expected [gray], levels = [...] and intensity = [...]")
        try:
            return cls.parse(table)
        except BadInput as error:
            raise BadInput(f"{file.name}, [gray]: {error}") from error

    @classmethod
    def parse(cls, table: dict[str, Any]) -> GrayCurve:
        """Make a curve from a table, as `describe` gives it.

        Args:
            table: The keys ``levels`` and ``intensity``.

        Returns:
            The curve.

        Raises:
            BadInput: A key is missing or unknown, or the curve is not valid.
        """
        if set(table) != {"levels", "intensity"}:
            raise BadInput(f"got the keys {', '.join(map(str, table)) or 'none'}; expected levels and intensity")
        return cls(table["levels"], table["intensity"])

    def __str__(self) -> str:
        half = float(np.interp(0.5, self.intensity, self.levels))
        shape = "linear in light" if len(self.levels) == 2 else f"half of full light at level {half:.0f}"
        return f"{shape}, black level {100 * self.black:.3g} % of full light" if self.black else shape

    def describe(self) -> dict[str, Any]:
        """The curve as plain lists, for files; `parse` reads it back."""
        return {"levels": list(self.levels), "intensity": list(self.intensity)}

    @property
    def black(self) -> float:
        """Light of level 0 relative to that of level 255."""
        return self.intensity[0]

    def __call__(self, level: Any) -> np.ndarray:
        """Relative light of gray levels 0 to 255 (whole or not); same shape."""
        return np.interp(level, self.levels, self.intensity)

    def inverse(self, light: Any) -> np.ndarray:
        """Find the whole level whose light is nearest; of two equally near, the lower one.

        Args:
            light: Relative light (...), any shape.

        Returns:
            Levels, uint8 [...] of the same shape.
        """
        curve = self.table(8)
        return np.searchsorted(0.5 * (curve[1:] + curve[:-1]), np.clip(light, 0.0, 1.0), side="left").astype(np.uint8)

    def table(self, bits: int) -> np.ndarray:
        """Light of every possible value of a pixel.

        Args:
            bits: 1 (off or on) or 8 (a gray level).

        Returns:
            Relative light, float64 (values,).

        Raises:
            BadInput: ``bits`` is another number.
        """
        if bits not in (1, 8):
            raise BadInput(f"bits is {bits!r}; expected 1 or 8")
        return self(np.array([0, TOP]) if bits == 1 else np.arange(TOP + 1))
