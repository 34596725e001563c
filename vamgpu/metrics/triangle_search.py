"""The nearest of many triangles, exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vamgpu.backend.cores import pointwise, threads

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_FIRST, _GROWTH = 8, 4
"""Number of pieces searched for a point, and its factor of growth while a nearer piece cannot be ruled out."""
_SURE = 2  # number of nearest pieces whose distance is computed first; it rules out most others
_ROUGH = 0.01
"""Relative error of a distance in a quick search: at a ball's center all pieces are about equally near, and an exact
search would visit all of them."""
_LEAF = 32
_PARTS = 16  # greatest number of parts into which a segment is cut
_BATCH = 1 << 18  # number of pairs of a point and a piece in memory at a time
_PIECES = 100_000  # long triangles are cut until pieces are as small as if this number of equal ones made the surface


class TriangleSearch:
    """Search over triangles that need not form a closed surface; build it once and query it often."""

    # corners: (m, 3, 3) [mm]; triangles without area are left out. longest: triangles with shorter edges [mm] need not
    # be cut, which protects small parts. kept: which of the triangles have an area, boolean (m,). corners: of those,
    # (k, 3, 3) [mm]. areas: cumulative sum of twice their areas [mm²], (k,). reach: largest distance of a piece's
    # points from its middle [mm].

    def __init__(self, corners: Array, longest: float = 0.0) -> None:
        from scipy.spatial import KDTree

        double = double_areas(corners)
        self.kept: np.ndarray = double > 0
        self.corners: np.ndarray = corners if self.kept.all() else corners[self.kept]
        self.areas: Array = double[self.kept].cumsum()
        limit = max(longest, float(np.sqrt(2.0 * double.sum() / _PIECES)))
        self._middles, self._reaches = _balls(self.corners)
        self._parent: Indices = np.arange(len(self.corners))
        if 2.0 * self._reaches.max(initial=0.0) > limit:  # otherwise no edge is longer
            pieces, self._parent = _pieces(self.corners, limit)
            self._middles, self._reaches = _balls(pieces)
        self.reach: float = float(self._reaches.max())
        self._tree = KDTree(self._middles, leafsize=_LEAF, balanced_tree=False, compact_nodes=False)

    def __call__(self, points: Array, *, exact: bool = True, most: int | None = None) -> tuple[Array, Array, Indices]:
        """Nearest points of the triangles."""
        # points (n, 3) [mm]; returns [mm] (n,) (n, 3)
        best, weight = np.full(len(points), np.inf), np.zeros((len(points), 3))
        face = np.zeros(len(points), np.int64)
        open_points, count = np.arange(len(points)), _FIRST
        while open_points.size:
            count = min(count, len(self._parent))
            sure = np.zeros(open_points.size, bool)
            step = max(1, _BATCH // count)
            nearest: Any = np.arange(1, count + 1)
            for first in range(0, open_points.size, step):
                chosen = open_points[first : first + step]
                query: Any = self._tree.query
                far, piece = query(points[chosen], k=nearest, eps=0.0 if exact else _ROUGH, workers=threads())
                best[chosen], weight[chosen], face[chosen] = self._closest(points[chosen], far, piece)
                sure[first : first + step] = far[:, -1] - self.reach >= best[chosen]
            if count >= min(len(self._parent), most or len(self._parent)) or not exact:
                break
            open_points, count = open_points[~sure], count * _GROWTH
        return best, weight, face

    def bounds(self, points: Array) -> tuple[Array, Array]:
        """Bounds of the distances [mm] of points (n, 3); several times faster than the distances."""
        far, _ = self._tree.query(points, workers=threads())
        # The nearest middle is at least `far` away; no piece is closer than that minus its reach.
        return np.maximum(far - self.reach, 0.0), far

    def near_segments(self, starts: Array, ends: Array) -> tuple[Indices, Indices]:
        """Triangles that may meet straight segments between points (n, 3) [mm]: pairs of a segment and a triangle."""
        # A pair may occur several times: balls around short parts of a segment contain fewer triangles than one around
        # all of it.
        length = _length(ends - starts)
        parts = int(np.clip(length.max(initial=0.0) / (4.0 * self.reach), 1, _PARTS))
        share = (np.arange(parts) + 0.5) / parts
        middle = (starts[:, None] + share[:, None] * (ends - starts)[:, None]).reshape(-1, 3)
        around = np.repeat(0.5 * length / parts + self.reach, parts)
        found: Any = self._tree.query_ball_point(middle, around, workers=threads())
        number = np.array([len(some) for some in found])
        segment = np.repeat(np.repeat(np.arange(len(starts)), parts), number)
        piece = np.concatenate([np.asarray(some, np.int64) for some in found])
        if not piece.size:
            return segment, piece
        # Pieces farther from the segment than their reach, most of the ball, cannot meet it.
        way = (ends - starts)[segment]
        offset = self._middles[piece] - starts[segment]
        share = np.clip(np.einsum("ij,ij->i", offset, way) / np.einsum("ij,ij->i", way, way), 0.0, 1.0)
        close = _length(offset - share[:, None] * way) <= self._reaches[piece]
        return segment[close], self._parent[piece[close]]

    def _closest(self, points: Array, far: Array, piece: Indices) -> tuple[Array, Array, Indices]:
        """The nearest of some pieces (n, k), by distance of their middles, to each point."""
        apart = np.full(piece.shape, np.inf)
        weight = np.zeros((*piece.shape, 3))
        looked = np.zeros(piece.shape, bool)
        looked[:, :_SURE] = True
        self._measure(points, piece, looked, apart, weight)
        best = apart.min(axis=1)
        self._measure(points, piece, ~looked & (far - self._reaches[piece] < best[:, None]), apart, weight)
        at, row = apart.argmin(axis=1), np.arange(len(points))
        return apart[row, at], weight[row, at], self._parent[piece[row, at]]

    def _measure(self, points: Array, piece: Indices, pairs: Any, apart: Array, weight: Array) -> None:
        """Fill in distances and weights of chosen pairs of a point and a piece."""
        row, column = np.nonzero(pairs)
        if not row.size:
            return
        asked, corners = points[row], self.corners[self._parent[piece[row, column]]]
        found = barycentric(asked, corners)
        apart[row, column] = _length(asked - np.einsum("nk,nki->ni", found, corners))
        weight[row, column] = found


def _balls(corners: Array) -> tuple[Array, Array]:
    """Middles (m, 3) of triangles, and the greatest distances (m,) of their corners from them."""

    def balls(some: Array) -> tuple[Array, ...]:
        middles = (some[:, 0] + some[:, 1] + some[:, 2]) / 3.0
        return *middles.T, np.max([_length(some[:, k] - middles) for k in range(3)], axis=0)

    *middles, reaches = pointwise(balls, corners)
    return np.stack(middles, axis=1), reaches


def double_areas(corners: Array) -> Array:
    """Twice the area [mm²] of each triangle (m, 3, 3)."""

    def areas(some: Array) -> tuple[Array]:
        (ax, ay, az), (bx, by, bz) = ((some[:, k] - some[:, 0]).T for k in (1, 2))
        return (np.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2),)

    return pointwise(areas, corners)[0]


def drawn_on(corners: Array, samples: int, areas: Array | None = None) -> tuple[Array, Indices]:
    """Points on triangles, uniformly distributed by area, with a fixed seed; areas: as in `TriangleSearch`."""
    # corners (m, 3, 3) [mm]; returns (samples, 3) [mm] (samples,)
    ends = double_areas(corners).cumsum() if areas is None else areas
    random = np.random.default_rng(0)
    # One point in each equal share of the area: no region is left out.
    at = (np.arange(samples) + random.random(samples)) * (ends[-1] / samples)
    face = np.searchsorted(ends, at).clip(max=len(corners) - 1)
    root, other = np.sqrt(random.random((samples, 1))), random.random((samples, 1))
    a, b, c = np.moveaxis(corners[face], 1, 0)
    return (1.0 - root) * a + root * (1.0 - other) * b + root * other * c, face


def barycentric(points: Array, corners: Array) -> Array:
    """Weights (n, 3) of the corners (n, 3, 3) of each triangle that make its point nearest to each point (n, 3)."""
    # On an edge one weight is exactly 0, at a corner two.
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    area = np.einsum("ni,ni->n", normal, normal)
    weight = np.stack([np.einsum("ni,ni->n", np.cross(q - p, points - p), normal) / area
                       for p, q in ((b, c), (c, a), (a, b))], axis=1)  # fmt: skip
    outside = np.flatnonzero((weight <= 0).any(axis=1))
    best = np.full(outside.size, np.inf)
    for k in range(3):  # the edge opposite to corner k
        p, q = corners[outside, (k + 1) % 3], corners[outside, (k + 2) % 3]
        way, start = q - p, points[outside] - p
        t = np.clip(np.einsum("ni,ni->n", start, way) / np.einsum("ni,ni->n", way, way), 0.0, 1.0)
        apart = ((start - t[:, None] * way) ** 2).sum(axis=1)
        nearer = apart < best
        best[nearer] = apart[nearer]
        row = outside[nearer]
        weight[row, k], weight[row, (k + 1) % 3], weight[row, (k + 2) % 3] = 0.0, 1.0 - t[nearer], t[nearer]
    return weight


def _pieces(corners: Array, limit: float) -> tuple[Array, Indices]:
    """Triangles cut at the middle of their longest edge until all are short, and the original of each piece."""
    done, parents = [], []
    left, parent = corners, np.arange(len(corners))
    while len(left):
        edges = np.stack([_length(left[:, k] - left[:, (k + 1) % 3]) for k in range(3)], axis=1)  # from each corner
        short = edges.max(axis=1) <= limit
        if short.all() and not done:
            return left, parent
        done.append(left[short])
        parents.append(parent[short])
        left, parent, longest = left[~short], parent[~short], edges[~short].argmax(axis=1)
        row = np.arange(len(left))
        a, b, c = (left[row, (longest + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        left = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        parent = np.concatenate([parent, parent])
    return np.concatenate(done), np.concatenate(parents)


def _length(vectors: Array) -> Array:
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
