"""A sparse matrix on the host, and the tables that `gather` reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device


@dataclass(frozen=True, eq=False)
class SparseEntries:
    """Entries of a matrix in any order: rows and columns, int32, and weights; those of one place add up."""

    row: np.ndarray
    column: np.ndarray
    weight: np.ndarray

    def transposed(self) -> SparseEntries:
        """The same entries, rows and columns exchanged."""
        return SparseEntries(self.column, self.row, self.weight)

    def table(self, device: Device, shape: tuple[int, int], block: int) -> dict[str, DeviceArray]:
        """What `gather_rows` needs of a matrix whose rows are ``shape``, in blocks of ``block`` columns."""
        major, minor = np.divmod(self.row, shape[1])
        blocks = -(-(int(self.column.max(initial=0)) + 1) // block)
        place = (major * blocks + self.column // block) * shape[1] + minor
        first, order = _sorted(place, shape[0] * blocks * shape[1])
        pairs = np.stack([self.column[order].astype(self.weight.dtype), self.weight[order]], axis=1)
        return {"first": device.table(first, "int32"), "entries": device.table(pairs)}


def _sorted(place: np.ndarray, places: int) -> tuple[np.ndarray, np.ndarray]:
    """Where each place's entries begin, and all entries by their places; those of one place keep their order."""
    from scipy.sparse import csr_array

    row = csr_array((np.arange(place.size, dtype=np.int32), place, np.array([0, place.size])), shape=(1, places))
    columns = row.tocsc()
    return columns.indptr, columns.data
