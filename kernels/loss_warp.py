"""Warp version of `loss`."""

from __future__ import annotations

from typing import Any

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.struct
class Band:
    """Arguments of `band_loss` that define the loss."""

    response: wp.array[float]
    start: float
    density: float
    low: float
    high: float
    slack_low: float
    slack_high: float
    gain_low: float
    gain_high: float
    power: float
    ridge: float
    n_sample: int


@wp.struct
class Sampled:
    """Arguments of `sampled_loss` that define the loss."""

    outer: wp.array[float]
    inner: wp.array[float]
    start: float
    density: float
    n_sample: int


@wp.struct
class Ramp:
    """Arguments of `ramp_loss` that define the loss."""

    outside: float
    inside: float
    most: float


@wp.func
def respond(dose: float, response: wp.array[float], start: float, density: float, n_sample: int):
    """Response at a dose and its derivative."""
    position = (dose - start) * density
    cell = wp.clamp(int(wp.floor(wp.min(position, 1.0e9))), 0, n_sample - 2)
    rise = response[cell + 1] - response[cell]
    return wp.vec2(response[cell] + rise * (position - float(cell)), rise * density)


@wp.func
def root_of(amount: float, power: float):
    """amount^(power − 1)."""
    result = float(1.0)
    if power == 2.0:
        result = amount
    elif power != 1.0:
        result = wp.pow(amount, power - 1.0)
    return result


@wp.func
def add_loss(loss: float, dose: float, f: float, weight: float, band: Band):
    """The sum of losses after one more voxel, and the derivative of its loss by its dose."""
    slope = float(0.0)
    answer = respond(dose, band.response, band.start, band.density, band.n_sample)
    difference = answer[0] - (band.low + (band.high - band.low) * f)
    excess = wp.abs(difference) - (band.slack_low + (band.slack_high - band.slack_low) * f)
    if excess > 0.0:
        gain = (band.gain_low + (band.gain_high - band.gain_low) * f) * weight
        root = root_of(excess, band.power)
        loss += gain * root * excess
        slope = wp.sign(difference) * gain * band.power * root * answer[1]
    value = difference + band.low + (band.high - band.low) * f
    return wp.vec2(loss + band.ridge * value * value, slope + 2.0 * band.ridge * value * answer[1])


@wp.func
def add_loss(loss: float, dose: float, f: float, weight: float, sampled: Sampled):  # noqa: F811 - Warp chooses by type
    """The sum of losses after one more voxel, and the derivative of its loss by its dose."""
    answer = (1.0 - f) * respond(dose, sampled.outer, sampled.start, sampled.density, sampled.n_sample)
    answer += f * respond(dose, sampled.inner, sampled.start, sampled.density, sampled.n_sample)
    return wp.vec2(loss + weight * answer[0], weight * answer[1])


@wp.func
def add_loss(loss: float, dose: float, f: float, weight: float, ramp: Ramp):  # noqa: F811 - Warp chooses by type
    """The sum of losses after one more voxel, and the derivative of its loss by its dose."""
    over = dose - (ramp.outside + (ramp.inside - ramp.outside) * f)
    error = wp.max(over, 0.0)
    if f >= 0.5:
        error = wp.min(over, 0.0) + wp.max(dose - ramp.most, 0.0)
    return wp.vec2(loss + 0.5 * weight * error * error, weight * error)


@wp.func
def evaluate(
    dose: Vectors, target: Vectors, weight: Vectors, weighted: int, binary: int, reach: float,
    parts: wp.array[float], slab: int, tile: int, j: int, lane: int, n_i: int, n_j: int, n_z: int, loss: Any,
):  # fmt: skip
    """Sum of the losses of a thread's samples as its partial result, and their derivatives in place of the doses."""
    count = real_lanes(slab, lane, dose.shape[3], n_z)
    result = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        slopes = wp.vec4(0.0, 0.0, 0.0, 0.0)
        if disc_distance(i, j, n_i, n_j) <= reach * reach:
            doses = dose[slab, i, j, lane]
            fractions = target[slab, i, j, lane]
            weights = wp.vec4(1.0, 1.0, 1.0, 1.0)
            if weighted != 0:
                weights = weight[slab, i, j, lane]
            for k in range(count):
                f = fractions[k]
                if binary != 0:
                    f = wp.where(f >= 0.5, 1.0, 0.0)
                both = add_loss(result, doses[k], f, weights[k], loss)
                result = both[0]
                slopes[k] = both[1]
        dose[slab, i, j, lane] = slopes
    parts[part_index(slab, tile, j, lane, n_i, n_j, dose.shape[3])] = result


@wp.kernel
def band_loss(
    dose: Vectors, target: Vectors, weight: Vectors, weighted: int, response: wp.array[float], start: float,
    density: float, low: float, high: float, slack_low: float, slack_high: float, gain_low: float, gain_high: float,
    power: float, ridge: float, binary: int, reach: float, parts: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_sample: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    band = Band(response, start, density, low, high, slack_low, slack_high, gain_low, gain_high, power, ridge, n_sample)
    evaluate(dose, target, weight, weighted, binary, reach, parts, slab, tile, j, lane, n_i, n_j, n_z, band)


@wp.kernel
def sampled_loss(
    dose: Vectors, target: Vectors, weight: Vectors, weighted: int, outer: wp.array[float],
    inner: wp.array[float], start: float, density: float, binary: int, reach: float,
    parts: wp.array[float], n_i: int, n_j: int, n_z: int, n_sample: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    sampled = Sampled(outer, inner, start, density, n_sample)
    evaluate(dose, target, weight, weighted, binary, reach, parts, slab, tile, j, lane, n_i, n_j, n_z, sampled)


@wp.kernel
def ramp_loss(
    dose: Vectors, target: Vectors, weight: Vectors, weighted: int, outside: float, inside: float, most: float,
    reach: float, parts: wp.array[float], n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    ramp = Ramp(outside, inside, most)
    evaluate(dose, target, weight, weighted, 0, reach, parts, slab, tile, j, lane, n_i, n_j, n_z, ramp)


@wp.kernel
def dark_loss(
    dose: Vectors, weight: wp.array[float], most: float, parts: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, dose.shape[3], n_z)
    result = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        slopes = wp.vec4(0.0, 0.0, 0.0, 0.0)
        doses = dose[slab, i, j, lane]
        for k in range(count):
            over = wp.max(doses[k] - most, 0.0)
            slopes[k] = weight[j] * over
            result += 0.5 * slopes[k] * over
        dose[slab, i, j, lane] = slopes
    parts[part_index(slab, tile, j, lane, n_i, n_j, dose.shape[3])] = result
