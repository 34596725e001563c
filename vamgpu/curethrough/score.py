"""Cured heights of features and voids in single columns of a print, from the bytes shown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.curethrough.dose import Stack, column_doses
from vamgpu.curethrough.printer import Machine

AT_ONCE = 256  # number of columns whose doses are in memory at a time
PEEKED = 24  # number of slices that are examined to find the part


@dataclass(frozen=True, eq=False)
class Features:
    """Runs of solid slices, one entry each."""

    column: np.ndarray  # number of the column
    front: np.ndarray  # first slice
    back: np.ndarray  # the slice after the last
    behind: np.ndarray  # slices of void between it and the next feature
    last: np.ndarray
    over: np.ndarray  # cured height [mm] of the void before it, that is, its cure-through
    under: np.ndarray  # uncured height [mm] within it

    @property
    def error(self) -> np.ndarray:
        """Height error [mm]: sum of excess and missing cured height."""
        return self.over + self.under

    def __len__(self) -> int:
        return len(self.column)


@dataclass(frozen=True, eq=False)
class Sample:
    """Followed columns: ``grid`` over the part, then one row of ``width`` pixels, then one column of pixels."""

    rows: np.ndarray
    columns: np.ndarray
    grid: int
    width: int

    @property
    def across(self) -> slice:
        """The columns of the row of pixels, from left to right."""
        return slice(self.grid, self.grid + self.width)

    @property
    def along(self) -> slice:
        """The columns of the column of pixels, from top to bottom."""
        return slice(self.grid + self.width, len(self.rows))

    def of(self, block: np.ndarray) -> np.ndarray:
        """A block [slice, y, x] at the columns; [slice, column]."""
        return block[:, self.rows, self.columns]


def sample(stack: Stack, threshold: int = 128, side: int = 48) -> Sample:
    """Columns to follow: side × side over the part's box, and the row and column of pixels with most of the part."""
    slices, ny, nx = stack.shape
    seen = np.zeros((ny, nx), int)
    for k in np.unique(np.linspace(0, slices - 1, PEEKED).astype(int)):
        seen += stack[k : k + 1][0] >= threshold
    filled = np.argwhere(seen)
    filled = filled if len(filled) else np.array([[0, 0], [ny - 1, nx - 1]])
    ends = zip(filled.min(axis=0), filled.max(axis=0), strict=True)
    at = [np.unique(np.linspace(low, high, side).round().astype(int)) for low, high in ends]
    rows, columns = (part.ravel() for part in np.meshgrid(*at, indexing="ij"))
    row, column = int(seen.sum(axis=1).argmax()), int(seen.sum(axis=0).argmax())
    return Sample(
        np.concatenate([rows, np.full(nx, row), np.arange(ny)]),
        np.concatenate([columns, np.arange(nx), np.full(ny, column)]),
        len(rows),
        nx,
    )


def cured(machine: Machine, shown: np.ndarray, critical: float = 1.0) -> np.ndarray:
    """Share of every slice's height that reaches the critical dose, for shown levels uint8 [slice, column]."""
    borders = column_doses(machine, shown)
    if machine.layered:
        start, stop, rest = borders[:-1], (1.0 - machine.decay) * borders[:-1], 0.0
    else:
        start, stop, rest = borders[1:], borders[:-1], machine.doses[shown] / machine.decay
    with np.errstate(divide="ignore", invalid="ignore"):
        done = np.log((critical - rest) / (start - rest)) * machine.fade_scale
    crosses = (start >= critical) != (stop >= critical)
    share = np.where(crosses, np.clip(done, 0.0, 1.0), 1.0)
    return np.where(start >= critical, share, 1.0 - share)


def features(machine: Machine, shown: np.ndarray, solid: np.ndarray, critical: float = 1.0) -> Features:
    """Features of columns and how they print. shown: uint8 [slice, column]; solid: bool, as many slices or fewer."""
    count = shown.shape[1]
    target = np.zeros(shown.shape, bool)
    target[: len(solid)] = solid
    found = [
        _features(machine, shown[:, k : k + AT_ONCE], target[:, k : k + AT_ONCE], k, critical)
        for k in range(0, count, AT_ONCE)
    ]
    return Features(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _features(
    machine: Machine, shown: np.ndarray, target: np.ndarray, first: int, critical: float
) -> tuple[np.ndarray, ...]:
    slices = len(shown)
    share, inside = cured(machine, shown, critical).T.ravel(), target.T.ravel()
    change = np.flatnonzero(inside[1:] != inside[:-1]) + 1
    starts = np.union1d(change, np.arange(0, len(inside), slices))
    ends = np.append(starts[1:], len(inside))
    solid = inside[starts]
    height = machine.slice_height
    done = np.add.reduceat(share, starts)
    which = np.flatnonzero(solid)
    front, column = starts[which] % slices, starts[which] // slices
    void = front > 0  # the run before a feature in its own column is void
    over = np.where(void, done[np.maximum(which - 1, 0)], 0.0)
    under = (ends - starts - done)[which]
    nxt = np.minimum(which + 1, len(starts) - 1)
    at_end = ends[which] % slices == 0
    behind = np.where(at_end, 0, (ends - starts)[nxt])
    last = at_end | (ends[nxt] % slices == 0)
    back = front + (ends - starts)[which]
    return column + first, front, back, behind, last, over * height, np.maximum(under, 0) * height


@dataclass(frozen=True)
class Group:
    """Features that lie at the same slices: how many columns have one, and mean height errors [mm]."""

    front: int
    back: int
    behind: int  # shortest void behind one, in slices
    last: bool  # no slices follow
    columns: int
    before: float
    after: float | None
    missed: int

    @property
    def ratio(self) -> float | None:
        """Ratio of corrected to uncorrected height error; None without both."""
        return None if self.after is None or self.before <= 0 else self.after / self.before


def grouped(before: Features, after: Features | None = None, tolerance: float = 0.0) -> tuple[Group, ...]:
    """Features by their position, the most frequent first. Both must be of the same columns of the same part."""
    keys = np.stack([before.front, before.back], axis=1)
    if len(keys) == 0:
        return ()
    places, which, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    shown = before if after is None else after
    mean = [np.bincount(which, weights) / count for weights in (before.error, shown.error)]
    last = np.bincount(which, shown.last) == count
    behind = np.full(len(count), np.iinfo(np.int64).max)
    np.minimum.at(behind, which, np.where(shown.last & ~last[which], behind[which], shown.behind))
    missed = np.bincount(which, shown.under > tolerance)
    order = np.argsort(-count, kind="stable")
    return tuple(
        Group(int(places[k, 0]), int(places[k, 1]), int(behind[k]), bool(last[k]), int(count[k]), float(mean[0][k]),
              None if after is None else float(mean[1][k]), int(missed[k]))
        for k in order
    )  # fmt: skip


def ratio(before: Features, after: Features) -> tuple[float, float]:
    """Ratio of corrected to uncorrected height errors (Fig. S6a): of all features, and the median of single ones."""
    wrong = before.error > 0
    single = after.error[wrong] / before.error[wrong]
    total = float(before.error.sum())
    middle = float(np.median(single)) if len(single) else 0.0
    return (float(after.error.sum()) / total if total > 0 else 0.0), middle
