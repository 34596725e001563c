"""Bands: the sparse light of one angle as short runs of neighboring columns, in the order of each direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.web import Propagation

CHUNK = 4  # weights of a band are padded to a multiple of this number, which a GPU reads at once


@dataclass(frozen=True)
class Bands:
    """Runs of weights by row of the target, in the form of `shift_window`."""

    # rows: (rows + 1,) first band of each.  bands: (bands, 4) source minor, first major, first chunk, count. weights:
    # (chunks, 4).  step, phases: sample m·phases + c of the target begins at m·step of the source.

    rows: np.ndarray
    bands: np.ndarray
    weights: np.ndarray
    step: int
    phases: int

    @classmethod
    def gathered(
        cls, count: int, row: np.ndarray, minor: np.ndarray, major: np.ndarray, weight: np.ndarray,
        step: int = 1, phases: int = 1,
    ) -> Bands:  # fmt: skip
        """Sort entries: the weight of source sample (major, minor) in one of ``count`` rows."""
        order = np.lexsort((major, minor, row))
        row, minor, major, weight = row[order], minor[order], major[order], weight[order]
        begins = np.ones(row.size, bool)
        begins[1:] = (np.diff(row) != 0) | (np.diff(minor) != 0) | (np.diff(major) != 1)
        first = np.flatnonzero(begins)
        lengths = np.diff(first, append=row.size)
        chunks = -(-lengths // CHUNK)
        chunk = np.cumsum(chunks) - chunks
        padded = np.zeros((max(int(chunks.sum()), 1), CHUNK))
        within = np.arange(row.size) - np.repeat(first, lengths)
        padded.reshape(-1)[np.repeat(chunk, lengths) * CHUNK + within] = weight
        table = np.stack([minor[first], major[first], chunk, lengths], axis=1).astype(np.int32)
        rows = np.searchsorted(row[first], np.arange(count + 1)).astype(np.int32)
        return cls(rows, table if len(table) else np.zeros((1, 4), np.int32), padded, step, phases)

    @classmethod
    def forward(cls, light: Propagation, start: int, step: int) -> Bands:
        """Bands that columns of light gather: pose p reads column p·step + start + l."""
        column = light.l.astype(np.int64) + start
        return cls.gathered(light.shape[0], light.r, light.rho, column, light.weight, step=step)

    @classmethod
    def transposed(cls, light: Propagation, start: int, step: int) -> Bands:
        """Bands that layers of the web gather: column m·step + c reads pose m − ⌊(start + l) / step⌋."""
        pose, phase = np.divmod(light.l.astype(np.int64) + start, step)
        row = phase * light.shape[1] + light.rho
        return cls.gathered(step * light.shape[1], row, light.r, -pose, light.weight, phases=step)

    def on(self, device: Device) -> dict[str, Any]:
        """The arguments of `shift_window`, with the tables on a device."""
        tables = {"rows": device.table(self.rows, "int32"), "bands": device.table(self.bands, "int32")}
        return tables | {"weights": device.table(self.weights), "step": self.step, "phases": self.phases}
