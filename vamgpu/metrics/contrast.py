"""Contrast: the share of a dose, or of the resin's response, that lies in the part."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.metrics.histogram import extremes
from vamgpu.metrics.parts import EVERYWHERE, IN, OUT, Parts

SMALLEST = 1e-30  # lower limit of targets that count as part; fractions of a voxel are far above this


def contrast(
    dose: DeviceArray | npt.ArrayLike,
    target: DeviceArray | npt.ArrayLike,
    response: Callable[[np.ndarray], np.ndarray] | None = None,
) -> float:
    """ξ = ∫ over Q of M(f) / ∫ over V of M(f), with Q where the target is above 0: 1 is best (eq. S12)."""
    # dose f, target: arrays of one shape, whose cells have equal volumes (a web [l, rho, z] or a vial's [x, y, z] with
    # corners), or fields of one device. response: M, of NumPy arrays; M(f) = f by default, and on devices, where a
    # field may already hold M(f). Source: J. Toombs et al., Roll-to-roll tomographic volumetric additive manufacturing,
    # section S10.
    if isinstance(dose, DeviceArray) and isinstance(target, DeviceArray) and response is None:
        total = extremes(Parts(dose, target, SMALLEST, EVERYWHERE)).total[0]
        return _share(float(total[IN]), float(total[IN] + total[OUT]))
    values, part = (np.asarray(a.numpy() if isinstance(a, DeviceArray) else a, np.float64) for a in (dose, target))
    if values.shape != part.shape or not values.size:
        raise ShapeMismatch(f"the dose has shape {values.shape}, the target {part.shape}; expected the same, not empty")
    made = values if response is None else np.asarray(response(values))
    if made.shape != values.shape:
        raise ShapeMismatch(f"the response made {made.shape} of a dose of {values.shape}; expected the same shape")
    if not np.isfinite(made).all() or made.min() < 0:
        raise BadInput(
            f"the response reaches from {made.min():g} to {made.max():g}; expected finite numbers ≥ 0, like doses"
        )
    return _share(float(made[part > 0].sum()), float(made.sum()))


def _share(inside: float, everywhere: float) -> float:
    if not everywhere > 0:
        raise BadInput(f"the response sums to {everywhere:g}; expected some light: a contrast needs a dose above 0")
    return inside / everywhere
