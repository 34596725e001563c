"""Voxels of a watched print: the light so far, the conversion in images, and the voxels that can be corrected."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import CPU, look_up, pointwise
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Real, Table, kernel

Places = Annotated[np.ndarray, Table("int32", ("pick", "3"))]
Picked = Annotated[np.ndarray, Table("float32", ("pick",), writes=True)]
Knots = Annotated[np.ndarray, Table("float32", ("knot",))]
Slices = Annotated[np.ndarray, Table("float32", ("z",))]
Columns = Annotated[np.ndarray, Table("float32", ("i", "j"))]
Samples = Annotated[np.ndarray, Table("float32", ("sample",))]


@kernel(over="picked")
def pick_voxels(field: Array, places: Places, picked: Picked) -> None:
    """picked[k] = field[places[k]]."""
    picked[...] = field[places[:, 0], places[:, 1], places[:, 2]]


@kernel(over="out", cpu=CPU)
def interpolate(x: Array, knots: Knots, values: Knots, out: ArrayOut) -> None:
    """Out = values at x, linear between ascending knots, and constant beyond them; out may be x."""
    out[...] = np.interp(x, knots, values)


@pointwise(over="gain")
def tilted_gain(up: Slices, aside: Columns, level: Real, along: Real, across: Real, gain: ArrayOut) -> None:
    """gain = level·(1 + along·up + across·aside)."""
    gain[...] = level * (1.0 + along * up + across * aside[:, :, None])


@pointwise(over="gain")
def match_dose(dose: Array, got: Array, least: Real, most: Real, gain: ArrayInOut) -> None:
    """gain ·= dose / got within 1/most … most, where both are more than ``least``."""
    known = np.minimum(dose, got) > least
    gain *= np.where(known, np.clip(dose / np.where(known, got, 1.0), 1.0 / most, most), 1.0)


@pointwise(over="weight")
def spare_voxels(
    dose: Array, target: Array, deviation: Array, share: Real, margin: Real, inside: Real, greatest: Real,
    weight: ArrayOut,
) -> None:  # fmt: skip
    """weight = 0 if a voxel certainly has too much dose: dose − share·deviation − margin above its limit, else 1."""
    # Limits are ``greatest`` in the part (a target of one half or more), and ``inside`` outside.
    sure = dose - (share * deviation + margin)
    weight[...] = np.where(np.where(target >= 0.5, sure > greatest, sure >= inside), 0.0, 1.0)


@pointwise(over="weight")
def likelihood_weights(
    dose: Array, seen: Array, deviation: Array, judged: Columns, samples: Samples, start: Real, density: Real,
    weight: ArrayOut, pull: ArrayOut,
) -> None:  # fmt: skip
    """Curvature and slope of the log-likelihood of a relative gain of each voxel's dose."""
    # weight = (M'·dose)² / deviation², pull = M'·dose·(seen − M) / deviation², with M the samples as in `look_up`. Both
    # are 0 where ``deviation`` is 0, which marks invalid voxels, and where ``judged`` is 0.
    made, rise = look_up(dose, samples, start, density)
    known = (deviation > 0.0) & (judged[:, :, None] > 0.0)
    slope = rise * density * dose
    over = np.where(known, deviation, 1.0)
    rate = np.where(known, slope / (over * over), 0.0)
    weight[...] = rate * slope
    pull[...] = rate * (seen - made)


@pointwise(over="dose")
def share_gain(
    pull: Array, weight: Array, least: Real, shared: Real, strength: Real, dose: ArrayInOut, deviation: ArrayOut
) -> None:  # fmt: skip
    """dose ·= 1 + pull / (weight + least); deviation = \\|dose before\\| / √(weight / shared + strength)."""
    deviation[...] = np.abs(dose) / np.sqrt(weight / shared + strength)
    dose *= 1.0 + pull / (weight + least)


@kernel(over="variance", cpu=CPU)
def conversion_deviation(
    extinction: Array, sharp: Array, rounded: Array, knots: Knots, slopes: Knots, model: Real, variance: ArrayInOut
) -> None:
    """variance = √(variance·slope² + 4·(sharp − rounded)² + model²), the standard deviation of conversion."""
    # slope is that of the last knot at or below the extinction, or of the first knot if there is none.
    piece = np.clip(np.searchsorted(knots, extinction, side="right") - 1, 0, len(knots) - 1)
    variance[...] = np.sqrt(variance * slopes[piece] ** 2 + 4.0 * (sharp - rounded) ** 2 + model**2)
