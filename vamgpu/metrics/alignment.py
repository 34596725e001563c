"""Alignment of a measured surface: the rigid motion that moves it onto its target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.metrics.nearest_points import Array, Nearest, as_points

STEPS, SAMPLES = 200, 2000
_ROUGH = 12
"""Number of steps that move points to their nearest points, before steps that also slide them along the surface."""
_SETTLED = 1e-7  # the last step moves no point by more than this share of the points' extent
_PATIENCE, _BETTER = 5, 1e-4  # or, after several steps, the best RMS distance improved by no more than this share
_DAMPING = 1e-2
"""Motions that change the distances less than this share of others, such as rotations of a ball, are suppressed."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """p → rotation · p + shift [mm]. rms: of the remaining distances [mm]. steps: number until it converged."""

    rotation: Array
    shift: Array
    rms: float
    steps: int

    def __call__(self, points: npt.ArrayLike) -> Array:
        """Points (n, 3) [mm], moved."""
        return as_points(points) @ self.rotation.T + self.shift

    @property
    def angle(self) -> float:
        """Angle of the turn [rad]."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))


def align(
    points: npt.ArrayLike, target: Nearest, *, start: Alignment | None = None, keep: float = 1.0, steps: int = STEPS
) -> Alignment:
    """Align points (n, 3) [mm] with a surface by iterated closest points."""
    # Source: P. J. Besl and N. D. McKay, IEEE TPAMI 14 (1992) 239. The first steps match points with their nearest
    # points; the others use the distances to the nearest faces (Y. Chen and G. Medioni, Image Vis. Comput. 10 (1992)
    # 145), which lets them slide. It finds the nearest of several fits; a start within 10° and a tenth of the part is
    # good. start: initial motion. keep: share of the points, those with the smallest distances, that each step uses:
    # below 1 for damaged prints. At most `SAMPLES` points are used, drawn with a fixed seed.
    from scipy.spatial.transform import Rotation

    cloud = as_points(points)
    if len(cloud) < 3:
        raise BadInput(f"got {len(cloud)} points to align; expected at least 3, better thousands")
    if not 0.1 <= keep <= 1.0:
        raise BadInput(f"keep is {keep!r}; expected a share of the points in 0.1..1")
    if len(cloud) > SAMPLES:
        cloud = cloud[np.random.default_rng(0).choice(len(cloud), SAMPLES, replace=False)]
    rotation, shift = (np.eye(3), np.zeros(3)) if start is None else (start.rotation, start.shift)
    extent = float(np.linalg.norm(np.ptp(cloud, axis=0)))
    best, last = Alignment(rotation, shift, np.inf, 0), steps
    moved = rms = np.inf
    for step in range(1, steps + 1):
        at = cloud @ rotation.T + shift
        found = target(at, exact=step > _ROUGH)
        chosen = np.argsort(np.abs(found.distance), kind="stable")[: max(3, int(keep * len(at)))]
        rms = float(np.sqrt(np.mean(found.distance[chosen] ** 2)))
        if step > _ROUGH and rms < best.rms:
            last = step + _PATIENCE if rms < (1.0 - _BETTER) * best.rms else last
            best = Alignment(Rotation.from_matrix(rotation).as_matrix(), shift, rms, step)  # without rounding errors
        if step > _ROUGH and (moved <= _SETTLED * extent or step >= last < steps):
            return best
        turn, move = (_matched if step <= _ROUGH else _slid)(at[chosen], found.point[chosen], found.normal[chosen])
        rotation, shift = turn @ rotation, turn @ shift + move
        moved = float(np.linalg.norm(cloud @ rotation.T + shift - at, axis=1).max())
    raise BadInput(
        f"the alignment did not settle in {steps} steps: the last one moved points by up to {moved:.3g} mm at an RMS "
        f"distance of {rms:.3g} mm; turn and move the print roughly into place first (start=), or allow more steps"
    )


def _matched(points: Array, feet: Array, normals: Array) -> tuple[Array, Array]:
    """The motion that brings points closest to the surface points nearest to them (W. Kabsch, 1976)."""
    del normals
    middle, goal = points.mean(axis=0), feet.mean(axis=0)
    u, _, vt = np.linalg.svd((points - middle).T @ (feet - goal))
    flip = np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)])
    turn = vt.T @ flip @ u.T
    return turn, goal - turn @ middle


def _slid(points: Array, feet: Array, normals: Array) -> tuple[Array, Array]:
    """The small motion that brings points closest to the tangent planes at their nearest points."""
    from scipy.spatial.transform import Rotation

    middle = points.mean(axis=0)
    size = float(np.sqrt(np.mean((points - middle) ** 2))) or 1.0
    rows = np.concatenate([np.cross(points - middle, normals) / size, normals], axis=1)
    u, s, vt = np.linalg.svd(rows, full_matrices=False)
    goal = u.T @ np.einsum("ni,ni->n", feet - points, normals)
    motion = vt.T @ (goal * s / (s**2 + (_DAMPING * s[0]) ** 2))
    turn = Rotation.from_rotvec(motion[:3] / size).as_matrix()
    return turn, middle - turn @ middle + motion[3:]
