"""Use of light: brightness of the frames, and share of the dose outside the part."""

from __future__ import annotations

from math import prod

from vamgpu.backend.array import DeviceArray
from vamgpu.metrics.histogram import above, extremes
from vamgpu.metrics.parts import IN, OUT, Parts


def light_sent(light: DeviceArray) -> float:
    """Σ of a sinogram [angle, r, z]."""
    return float(extremes(Parts.whole(light)).total[0, IN])


def mean_brightness(light: DeviceArray, full: float | None = None) -> float:
    """Divide the mean light of all pixels and angles by that of a full-on pixel.

    As in B. Nicolet et al., ACM Trans. Graph. 43 (2024), "Inverse rendering for tomographic volumetric additive
    manufacturing".

    Args:
        light: Sinogram [angle, r, z].
        full: Light of a full-on pixel, in the unit of the sinogram's light [light]; its own greatest value by default.

    Returns:
        The share.
    """
    ends = extremes(Parts.whole(light))
    peak = float(ends.greatest[0, IN]) if full is None else full
    return float(ends.total[0, IN]) / prod(light.shape) / peak if peak > 0 else 0.0


def outside_over_inside(dose: DeviceArray, target: DeviceArray) -> float:
    """Mean dose of the judged voxels outside the part over the mean of those in it."""
    # 0 if all light goes to the part, 1 if the void gets as much per volume. A method that lights everything equally is
    # bright, but not better. dose [x, y, z]; target [x, y, z]
    parts = Parts(dose, target)
    total = extremes(parts).total[0]
    count = above(parts, 0.0)[0].sum(axis=1)
    mean = [float(total[side]) / max(int(count[side]), 1) for side in (OUT, IN)]
    return mean[OUT] / mean[IN] if mean[IN] > 0 else float("nan")
