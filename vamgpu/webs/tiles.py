"""The target of a web as a stream: columns in order, with as few of them in memory as possible."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from math import ceil
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from vamgpu.errors import BadInput, TileError
from vamgpu.geometry import positive
from vamgpu.targets.stream import Repeated, stream
from vamgpu.web import WebGrid

if TYPE_CHECKING:
    from vamgpu.targets.implicit import Implicit

ALONG = 64  # columns of a tile that is sampled from a function or a mesh
_END = object()  # mark of the end of the tiles; a tile that is None is an error, not an end


class Columns:
    """Columns of a target in the order in which they pass the light, float32 [l, rho, z] in 0..1. Raises `BadInput`."""

    def __init__(self, source: Any, grid: WebGrid, length: float | None = None) -> None:
        self.grid = grid
        self.limit: int | None = (
            None if length is None else ceil(positive("length [mm]", length) / grid.edges[0] - 1e-6)
        )
        self._tiles = iter(_tiles(source, grid, length))
        self._read = 0
        if isinstance(source, np.ndarray) and self.limit is not None and len(source) < self.limit:
            raise self._short(len(source), "an array longer along l")  # checked before anything is written
        self._held: deque[np.ndarray] = deque()
        self._first = 0
        self._ended = False

    @property
    def end(self) -> int | None:
        """Columns of the whole web; None until known."""
        return self.limit if self.limit is not None else (self._read if self._ended else None)

    def take(self, start: int, stop: int) -> np.ndarray:
        """Columns start to stop, 0 beyond the web; earlier ones are dropped. Raises `TileError`."""
        while not self._ended and self._read <= stop:  # one more than needed shows whether the web ends
            self._advance(start)
        out = np.zeros((stop - start, *self.grid.shape[1:]), np.float32)
        first = self._first
        for held in self._held:
            low, high = max(start, first), min(stop, first + len(held))
            if low < high:
                out[low - start : high - start] = held[low - first : high - first]
            first += len(held)
        return out

    def _advance(self, start: int) -> None:
        """Read one more tile and drop the columns before ``start``."""
        if self.limit is not None and self._read >= self.limit:
            self._ended = True
            return
        item = next(self._tiles, _END)
        if item is _END:
            if self.limit is not None or self._read == 0:
                raise self._short(self._read, "the missing tiles to continue")
            self._ended = True
            return
        columns = self._checked(item)
        if self.limit is not None:
            columns = columns[: self.limit - self._read]
        self._read += len(columns)
        self._held.append(columns)
        while self._held and self._first + len(self._held[0]) <= start:
            self._first += len(self._held.popleft())

    def _short(self, columns: int, remedy: str) -> TileError:
        expected = "at least one" if self.limit is None else f"{self.limit} ({self._mm(self.limit)})"
        return TileError(
            f"the tiles end after {columns} columns ({self._mm(columns)}); expected {expected}: give {remedy}, or "
            "begin a shorter web"
        )

    def _checked(self, item: Any) -> np.ndarray:
        where = f"the tile at column {self._read} ({self._mm(self._read)})"
        pitch = getattr(getattr(item, "grid", item), "pitch", None)
        if pitch is not None:
            edges = np.asarray(pitch, float).ravel()
            edges = np.repeat(edges, 3) if edges.size == 1 else edges
            if edges.size != 3 or not np.allclose(edges, self.grid.edges, rtol=1e-6, atol=0.0):
                raise TileError(
                    f"{where} has voxels of {_by(edges)} mm, the web of {_by(self.grid.edges)} mm: resample it"
                )
        values = np.asarray(item.numpy() if hasattr(item, "numpy") else item)
        if values.ndim != 3 or values.shape[1:] != self.grid.shape[1:] or not values.shape[0]:
            raise TileError(
                f"{where} has shape {values.shape}; expected [l, {self.grid.shape[1]}, {self.grid.shape[2]}] = "
                "[l, rho, z], like the tiles before it"
            )
        if values.dtype.kind not in "fiub":
            raise TileError(f"{where} holds {values.dtype}; expected fractions 0..1")
        low, high = float(values.min()), float(values.max())
        if not (low >= 0.0 and high <= 1.0):
            raise TileError(f"{where} reaches from {low:g} to {high:g}; expected fractions in 0..1: scale it")
        return values.astype(np.float32)

    def _mm(self, columns: int) -> str:
        return f"{columns * self.grid.edges[0]:.4g} mm"


def _by(edges: Any) -> str:
    return " × ".join(f"{edge:.6g}" for edge in edges)


def _tiles(source: Any, grid: WebGrid, length: float | None) -> Iterable[Any]:
    """Tiles of any kind of target."""
    if isinstance(source, Repeated) or (callable(source) and not isinstance(source, Iterator)):
        if length is None:
            raise BadInput(f"{source!r} has no end; give the length of the web [mm]")
        return stream(cast("Implicit | Repeated", source), (grid.shape[1], grid.shape[2]), grid.edges, length, ALONG)
    if isinstance(source, np.ndarray):
        return (source,)
    if isinstance(source, Iterable):
        return source
    raise BadInput(
        f"got {type(source).__name__} as tiles; expected an iterator of arrays [l, rho, z], a function φ(l, rho, z) "
        "that is negative in the solid, or Repeated(solid, period)"
    )
