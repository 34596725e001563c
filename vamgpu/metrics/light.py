"""How well light is used."""

from __future__ import annotations

from math import prod

from vamgpu.backend.array import DeviceArray
from vamgpu.metrics.histogram import extremes
from vamgpu.metrics.parts import IN, Parts


def light_sent(light: DeviceArray) -> float:
    """Σ of a sinogram [angle, r, z]."""
    return float(extremes(Parts.whole(light)).total[0, IN])


def light_efficiency(light: DeviceArray, full: float | None = None) -> float:
    """Mean over all pixels and poses of the light, over ``full``, the light of a full-on pixel.

    light: sinogram [angle, r, z].  full: its own greatest value by default, as in B. Nicolet et al., ACM Trans. Graph.
    43 (2024), "Inverse rendering for tomographic volumetric additive manufacturing".
    """
    ends = extremes(Parts.whole(light))
    peak = float(ends.greatest[0, IN]) if full is None else full
    return float(ends.total[0, IN]) / prod(light.shape) / peak if peak > 0 else 0.0
