"""The two limits of a gray dose, as far from both ends of its tolerance as all other limits are from the threshold."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import inf

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.reduce import disc
from vamgpu.operators.reductions import dot, extent
from vamgpu.targets.limits import Limits

GRAY = 2.0
"""Class of a gray voxel less its tolerance; see `vamgpu.kernels.saddle`."""


@dataclass(frozen=True)
class GrayPrices:
    """What the prices of gray doses come to, as sums over the voxels.

    Args:
        on_least: On the least dose of the part, what its prices there come to included.
        on_leak: On the greatest dose outside, without that of voids.
        fixed: Least cost of the limits, free of both, less what lower ones pay.
    """

    on_least: float
    on_leak: float
    fixed: float


class GrayLimits:
    """Bodies of a target that are gray, each by its tolerance t, in units of the greatest dose of the part.

    With the least dose a of the part and the greatest b outside, the part's middle is m = (1 + a)/2, and a gray dose
    keeps (a − b)/2 from (1 ± t)·m, as all others do from the threshold (a + b)/2; it is a at least and 1 at most.

    Args:
        target: Fractions [x, y, z] on the device; of several scenarios one above the other.
        limits: Of the same voxels.
        reach: Radius of the cylinder that counts, in voxels.
    """

    classes: DeviceArray
    voxels: float
    tolerances: tuple[float, ...]
    reach: float

    def __init__(self, target: DeviceArray, limits: Limits, reach: float) -> None:
        fractions = target.numpy()
        shares = np.array([body.tolerance for body in limits.bodies] + [0.0], np.float32)[limits.body]
        gray = limits.gray & (fractions >= 0.5) & limits.judged
        self.classes = target.device.upload(np.where(gray, np.float32(GRAY) + shares, fractions).astype(np.float32))
        near = disc(fractions.shape[0], fractions.shape[1], reach)[:, :, None] & gray
        self.voxels, self.reach = float(np.count_nonzero(near)), reach
        self.tolerances = tuple(float(each) for each in np.unique(shares[near]))

    @staticmethod
    def loose(least: float, leak: float) -> float:
        """Tolerance from which on the limits of a gray dose are those of the part.

        Args:
            least: Dose of the part at least, over the greatest.
            leak: Dose outside at most.

        Returns:
            The tolerance, a share.
        """
        return (1.0 - leak) / (1.0 + least)

    def window(self, dose: DeviceArray, least: float, leak: float, greatest: float) -> float:
        """How far all doses may be off, twice: the widest a − b at which every limit holds.

        Args:
            dose: [x, y, z], of any scale.
            least: Least dose of the part, gray or not.
            leak: Greatest dose outside.
            greatest: Greatest dose of all.

        Returns:
            A share of the greatest dose; −1 where there is none.
        """
        if not (np.isfinite([least, greatest]).all() and greatest > 0.0 and leak < inf):
            return -1.0
        top, low = least / greatest, max(leak, 0.0) / greatest
        lines = [(0.0, low)]  # b ≥ slope·a + offset
        for share in self.tolerances:
            close = 1e-6 * (1.0 + share)
            found = extent(dose, self.classes, GRAY + share - close, GRAY + share + close, self.reach)
            dark, bright = (each / greatest for each in found)
            lines += [(2.0 - share, 1.0 - share - 2.0 * dark), (-share, 2.0 * bright - 1.0 - share)]
        crossings = [
            (other[1] - one[1]) / (one[0] - other[0]) for one, other in product(lines, lines) if one[0] > other[0]
        ]
        return max(
            a - max(slope * a + offset for slope, offset in lines)
            for a in (top, *(min(max(each, 0.0), top) for each in crossings))
        )

    def owed(self, wall: DeviceArray, cap: DeviceArray, loose: float) -> GrayPrices:
        """What the prices come to.

        Args:
            wall: Prices of a dose too low [x, y, z].
            cap: Prices of a dose too high.
            loose: What `loose` told when they were found.

        Returns:
            The sums.
        """
        classes = self.classes.numpy()
        part, share = classes >= 0.5, classes - GRAY
        tight = (classes >= 1.5) & (share < loose)

        def summed(prices: DeviceArray, gray: np.ndarray, other: float) -> float:
            weights = np.where(tight, gray, np.where(part, other, 0.0)).astype(np.float32)
            return dot(prices, prices.device.upload(weights))

        half = np.full(classes.shape, 0.5)
        return GrayPrices(
            summed(wall, 1.0 - 0.5 * share, 1.0) - summed(cap, 0.5 * share, 0.0),
            summed(wall, half, 0.0) + summed(cap, half, 0.0),
            summed(cap, half * (1.0 + share), 1.0) - summed(wall, half * (1.0 - share), 0.0),
        )
