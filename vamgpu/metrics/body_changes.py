"""Bodies, holes and cavities of a part that its print has lost, joined or gained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.metrics.runs import Indices, Runs
from vamgpu.metrics.topology import Topology

_LOST = 0.5  # a body or a cavity is lost if less than this share of it remains
_SPECK, _TINY = 8, 1e-4
"""Number of voxels, and share of the largest body, below which a body is a fragment that sampling breaks off."""


@dataclass(frozen=True)
class BodyChanges:
    """Bodies, holes and cavities of a part and of its print, counted on one grid."""

    bodies: int
    bodies_lost: int  # less than half of them is printed
    bodies_merged: int  # bodies joined to another one: two balls printed as one are one merged
    bodies_broken: int  # printed in more than one piece
    bodies_extra: int  # bodies of the print that share no voxel with the part
    extra_volume: float  # total volume of those [mm³]
    holes: int  # through holes of the part
    # holes_closed, holes_opened: through holes missing from, or added to, the print of each body. They are counted, not
    # matched: if a body loses one and gains another, neither shows
    holes_closed: int
    holes_opened: int
    cavities: int  # closed voids of the part
    cavities_filled: int  # less than half of them is empty
    # closed voids of the print that share no voxel with one of the part, such as a pore, or the inside of a hole whose
    # mouths are closed
    cavities_extra: int

    @property
    def none(self) -> bool:
        """Whether bodies, holes and cavities of the print match those of the part."""
        kinds = ("lost", "merged", "broken", "extra")
        changed = [getattr(self, f"bodies_{kind}") for kind in kinds]
        return not any((*changed, self.holes_closed, self.holes_opened, self.cavities_filled, self.cavities_extra))


def body_changes(part: Topology, printed: Topology, voxel_volume: float) -> BodyChanges:
    """Compare a part and its print, labeled on one grid."""
    # voxel_volume [mm³]
    table = _shared(part.runs, part.body, printed.runs, printed.body)
    one, other, shared = table
    printed_share = np.bincount(one, shared, part.bodies + 1)[1:] / np.maximum(part.size, 1)
    speck, dust = (each.size < min(_SPECK, _TINY * each.size.max(initial=0)) for each in (part, printed))
    lost = (printed_share < _LOST) & ~speck
    touched = np.zeros(printed.bodies + 1, bool)
    touched[other] = True
    kept = ~(lost | speck)
    main = _main(table, part.bodies)[kept]
    pieces = np.bincount(_main((other, one, shared), printed.bodies)[~dust], minlength=part.bodies + 1)[1:]
    closed, opened = _holes(part, printed, table, lost)
    filled, extra = _cavities(part, printed)
    return BodyChanges(
        bodies=int((~speck).sum()),
        bodies_lost=int(lost.sum()),
        bodies_merged=int(kept.sum() - len(np.unique(main))),
        bodies_broken=int((pieces[kept] > 1).sum()),
        bodies_extra=int((~touched[1:]).sum()),
        extra_volume=float(printed.size[~touched[1:]].sum()) * voxel_volume,
        holes=int(part.holes.sum()),
        holes_closed=closed,
        holes_opened=opened,
        cavities=part.cavities,
        cavities_filled=filled,
        cavities_extra=extra,
    )


_Table = tuple[Indices, Indices, Indices]


def _shared(a: Runs, number_a: Indices, b: Runs, number_b: Indices) -> _Table:
    """Pairs of the numbers of runs that share voxels, and how many."""
    one, other, both = a.shared(b)
    width = int(number_b.max(initial=0)) + 1
    pair, which = np.unique(number_a[one] * width + number_b[other], return_inverse=True)
    return pair // width, pair % width, np.bincount(which, both.length, len(pair)).astype(np.int64)


def _main(table: _Table, number: int) -> Indices:
    """For each first label, the second label that shares most voxels with it, (number,); 0 if there is none."""
    one, other, shared = table
    order = np.argsort(shared, kind="stable")  # the largest is written last
    main = np.zeros(number + 1, np.int64)
    main[one[order]] = other[order]
    return main[1:]


def _holes(part: Topology, printed: Topology, table: _Table, lost: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """Holes closed and opened, by groups of bodies whose prints are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    size = part.bodies + printed.bodies
    ends = table[0] - 1, table[1] - 1 + part.bodies
    _, group = connected_components(coo_array((np.ones(len(ends[0]), np.int8), ends), (size, size)), directed=False)
    counted = np.where(lost, 0, part.holes)
    change = np.bincount(group, np.concatenate([-counted, printed.holes])).astype(np.int64)
    opened = int(change[change > 0].sum())
    return int(-change[change < 0].sum()), max(opened - part.pierced, 0)


def _cavities(part: Topology, printed: Topology) -> tuple[int, int]:
    """Cavities of the part that are filled, and those of the print that are new."""
    own, _, filled = part.hollow.shared(printed.runs)
    empty = part.cavity_size - np.bincount(part.cavity[own], filled.length, part.cavities + 1)[1:]
    _, other = part.hollow.meeting(printed.hollow)
    return int((empty < _LOST * part.cavity_size).sum()), printed.cavities - len(np.unique(printed.cavity[other]))
