"""Causes of a print's faults that can be checked: too few angles, an unfinished run, narrow features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.methods.part import radius_of
from vamgpu.metrics.body_changes import BodyChanges, body_changes
from vamgpu.metrics.depth import LARGEST_REACH, padded_depth
from vamgpu.metrics.runs import runs_of
from vamgpu.metrics.topology import topology
from vamgpu.optics.sampling import more_angles, resin_pixel

if TYPE_CHECKING:
    from vamgpu.printing.judgement import Judgement
    from vamgpu.printing.proof import Proof

EVALUATIONS = "use more evaluations"
CONVERGED = "more evaluations hardly improve these patterns: use smaller pixels, or another method"
BOUNDED = "no patterns do much better here: use smaller pixels, or a larger part"
THIN = "thicken features thinner than two pixels, or use smaller pixels"
NARROW = "widen gaps narrower than two pixels, or use smaller pixels"
REACHED = 0.98  # share of the widest window; if a plan exceeds it, no other patterns do much better
TAIL, STILL = 0.25, 0.02
"""The last share of a run, and the relative drop of its loss there: with a greater drop, it is still improving."""
LOST = 0.05  # share of lost wall area above which the distance of 95 % of the surface shows the loss


class Causes:
    """Causes of the faults of one print; each is checked when a remedy needs it."""

    proof: Proof
    judgement: Judgement

    def __init__(self, proof: Proof, judgement: Judgement) -> None:
        self.proof, self.judgement = proof, judgement

    def body(self, kind: str, number: int) -> str:
        """Remedy for one kind of change; features are narrow if a surface moved by a pixel makes the same changes."""
        found = []
        explained = 0
        for moved, remedy in zip(self._surfaces_moved, (THIN, NARROW), strict=True):
            if count := getattr(moved, kind):
                found.append(remedy)
                explained = max(explained, count)
        return "; ".join(found if explained >= number else [self.light, *found])

    @cached_property
    def light(self) -> str:
        """Remedy for patterns that could be better: more bits, more angles, more evaluations, or none of these."""
        proof, enough, few = self.proof, self._more_angles, getattr(self.proof.frames, "bits", 8) < 8
        own = proof.claimed.window if proof.corners is None else proof.corners.window
        bounded = proof.bound is not None and proof.bound.share(own) >= REACHED
        rest = BOUNDED if bounded else CONVERGED if converged(proof.history) else EVALUATIONS
        return "; ".join(["use 8-bit frames"] * few + [f"use {enough:,} angles"] * (enough > 0) + [rest])

    @property
    def rough(self) -> str:
        """Remedy for a rough surface; it also names walls thinner than two pixels if they did not print."""
        walls = self.judgement.surface.walls
        thin = walls.share_lost >= LOST and walls.thinnest_lost < 2.0 * self.judgement.pixel
        return f"{self.light}; {THIN}" if thin else self.light

    @property
    def deep(self) -> str:
        """Remedy if no exposure prints the deep voxels correctly. A part without deep voxels counts as thin."""
        thin = not self.judgement.over_tolerance.judged_at(self.judgement.deep)
        return f"{self.light}; {THIN}" if thin else self.light

    @property
    def _more_angles(self) -> int:
        """Number of angles that the part needs; 0 if there are enough, or if the number is unknown."""
        A, target = self.proof.operator, self.proof.target
        radius = radius_of(A, target, target)
        try:
            return more_angles(A.motion, resin_pixel(A.beam, A.vessel)[0], radius)
        except BadInput:
            return 0

    @cached_property
    def _surfaces_moved(self) -> tuple[BodyChanges, BodyChanges]:
        """Bodies that change if the surface moves inward by a pixel, and those that change if it moves outward."""
        grid, flat = self.proof.operator.grid, self.proof.operator.beam.flat
        reach = min(self.judgement.pixel / grid.pitch, LARGEST_REACH - 3.0)
        depth, _ = padded_depth(self.proof.target.numpy(), reach, flat, self.proof.operator.device)
        part = topology(runs_of(depth > 0.0))
        moved = (topology(runs_of(depth, at)) for at in (reach, -reach))
        inside, outside = (body_changes(part, one, grid.voxel_volume) for one in moved)
        return inside, outside


def converged(history: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the last quarter of a run lowered its loss by less than 2 %; False if unknown."""
    loss = [float(step["loss"]) for step in history if step.get("loss") is not None]
    if len(loss) < 4 or not np.isfinite(loss).all():
        return False
    before, after = min(loss[: ceil((1.0 - TAIL) * len(loss))]), min(loss)
    return before - after <= STILL * abs(before)
