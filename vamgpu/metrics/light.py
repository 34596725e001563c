"""How well light is used."""

from __future__ import annotations

from vamgpu.backend.array import DeviceArray
from vamgpu.metrics.histogram import extremes
from vamgpu.metrics.parts import IN, Parts


def light_efficiency(light: DeviceArray, full: float | None = None) -> float:
    """Mean over all pixels and poses of the light, over ``full``, the light of a full-on pixel.

    light: sinogram [angle, r, z].  full: its own greatest value by default, as in B. Nicolet et al., ACM Trans. Graph.
    43 (2024), "Inverse rendering for tomographic volumetric additive manufacturing".
    """
    ends = extremes(Parts.whole(light))
    peak = float(ends.greatest[0, IN]) if full is None else full
    angles, columns, rows = light.shape
    return float(ends.total[0, IN]) / (angles * columns * rows) / peak if peak > 0 else 0.0


def absorbed_share(dose_in: float, light: DeviceArray) -> float:
    """Power absorbed in the part over power sent, for a dose straight from the transpose of an absorbing projection.

    dose_in: Σ of Aᵀ light over the part. Pixel area, dwell and voxel volume cancel. Without absorption this is the mean
    length [mm] that light travels inside the part instead.
    """
    sent = float(extremes(Parts.whole(light)).total[0, IN])
    return dose_in / sent if sent > 0 else 0.0
