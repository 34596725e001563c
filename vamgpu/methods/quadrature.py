"""Share of all directions that each angle of a scan represents."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN, Turntable

GAP, NEAR = 4.0, 2
"""A gap that is this many times wider than the widest neighboring gap on either side separates two ranges."""
WHOLE = 0.95  # share of all directions above which a scan counts as complete, because random angles leave gaps


def directions(motion: Turntable) -> np.ndarray:
    """The range [rad] of directions, 0 to π in all, of each angle (angles,), shared with light from the other side."""
    if motion.theta is None:
        return np.full(motion.angles, 0.5 * FULL_TURN / motion.angles)
    low, high = _cells(motion.poses)
    width = high - low
    covered, other = _covered(low, high), low % FULL_TURN + 0.5 * FULL_TURN
    opposite = covered(other + width) - covered(other)
    return width**2 / np.maximum(width + opposite, 1e-300)


def is_complete(motion: Turntable) -> bool:
    """Whether a scan has light from all directions, according to its angles."""
    return float(directions(motion).sum()) >= WHOLE * 0.5 * FULL_TURN


def check_complete(motion: object) -> None:
    """Raise `BadInput` for a scan that lacks directions; anything but a turntable passes."""
    if isinstance(motion, Turntable) and not is_complete(motion):
        seen = np.degrees(directions(motion).sum())
        raise BadInput(
            f"filtered back projection got {motion} angles, which cover {seen:.3g}° of all directions; expected 180°, "
            "without which it cannot invert: scan a half turn, or choose an iterative method, such as the default"
        )


def balance(motion: Turntable) -> np.ndarray | None:
    """Factors (angles,) of filtered light that make Aᵀ · filter · A uniform over directions; None if all are 1."""
    if motion.is_even:
        return None
    return directions(motion) * motion.angles / (0.5 * FULL_TURN) / motion.times**2


def _cells(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper end [rad] of the range that each angle represents between its neighbors."""
    order = np.argsort(theta % FULL_TURN, kind="stable")
    sorted_theta = (theta % FULL_TURN)[order]
    after = np.diff(sorted_theta, append=sorted_theta[0] + FULL_TURN)
    near = range(1, min(NEAR + 1, theta.size))
    behind, ahead = (np.max([np.roll(after, way * k) for k in near] or [after], axis=0) for way in (1, -1))
    ends = after > GAP * np.maximum(behind, ahead)
    low, high = np.empty_like(theta), np.empty_like(theta)
    low[order] = sorted_theta - 0.5 * np.roll(np.where(ends, ahead, after), 1)
    high[order] = sorted_theta + 0.5 * np.where(ends, behind, after)
    return low, high


def _covered(low: np.ndarray, high: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """How much of the range up to an angle of 0 to 4π [rad] the cells of a repeated turn cover."""
    # repeated on the turns before and after, for cells that extend over the end of one
    turns = FULL_TURN * np.arange(-1, 3)[:, None]
    ends = np.concatenate([(low % FULL_TURN + turns).ravel(), (low % FULL_TURN + (high - low) + turns).ravel()])
    order = np.argsort(ends, kind="stable")
    rate = np.cumsum(np.repeat([1.0, -1.0], ends.size // 2)[order])
    total = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(ends[order]))])
    return lambda angle: np.interp(angle, ends[order], total)
