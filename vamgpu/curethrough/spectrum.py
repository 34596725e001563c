"""A lamp of several wavelengths: how deep its light cures a resin that absorbs them differently."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.schema.quantities import numeric
from vamgpu.storage.tables import read_table

SHALLOW, DEEP, STEP = -8.0, 60.0, 0.005  # range of cured heights in absorption heights, and the step of their table


class LampSpectrum:
    """Shares of a lamp's light by wavelength, and how strongly a resin absorbs each.

    The dose at the depth z is proportional to Σ wᵢ rᵢ·10^(−rᵢ z / h_a), with shares wᵢ and absorptions rᵢ relative to
    their mean. One wavelength gives the law of Jacobs; with several, the least absorbed one reaches deepest.

    Args:
        light: Light at each wavelength, in any unit, (wavelengths,).
        absorption: Absorption of the resin at each, in any unit, (wavelengths,).

    Raises:
        BadInput: Values are not finite or negative, differ in number, or no light is absorbed.
    """

    def __init__(self, light: Any, absorption: Any) -> None:
        shares, relative = numeric("light", light), numeric("absorption", absorption)
        if shares.shape != relative.shape or min(shares.min(), relative.min()) < 0:
            raise BadInput(f"got light of shape {shares.shape} and absorptions of shape {relative.shape}; expected "
                           "one of each for every wavelength, finite and 0 or more")  # fmt: skip
        mean = float(shares @ relative)
        if not mean > 0.0:
            raise BadInput("the resin absorbs none of the lamp's light; expected light where it absorbs: correct them")
        self.shares: np.ndarray = shares / shares.sum()
        self.relative: np.ndarray = relative * shares.sum() / mean

    @classmethod
    def read(cls, path: str | Path) -> LampSpectrum:
        """Read a table with the columns ``light`` and ``absorption``, a line for each wavelength, evenly spaced.

        Args:
            path: The file.

        Returns:
            The spectrum.

        Raises:
            StorageError: The file cannot be read.
            BadInput: It lacks a column, or its numbers are no spectra.
        """
        table = read_table(path)
        if not {"light", "absorption"} <= set(table.cells):
            raise table.lacks("light and absorption, in any unit, with a line for each wavelength")
        return cls(table.numbers("light"), table.numbers("absorption"))

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        depth = np.arange(SHALLOW, DEEP, STEP)
        doses, absorbed = self.shares * self.relative, self.shares * self.relative > 0.0
        logs = np.log(doses[absorbed])[:, None] - np.log(10.0) * np.outer(self.relative[absorbed], depth)
        return -np.logaddexp.reduce(logs, axis=0) / np.log(10.0), depth

    def depth(self, exposure: Any) -> np.ndarray:
        """Cured height of exposures.

        Args:
            exposure: log10 of the exposure over the one that just gels the surface, (...,).

        Returns:
            Height in absorption heights, (...,).
        """
        return np.interp(exposure, *self._table)
