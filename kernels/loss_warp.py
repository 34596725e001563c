"""Warp sibling of `loss`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func
def respond(dose: float, response: wp.array(dtype=float), start: float, density: float, n_sample: int):
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


@wp.kernel
def band_loss(
    dose: wp.array4d(dtype=wp.vec4),
    target: wp.array4d(dtype=wp.vec4),
    weight: wp.array4d(dtype=wp.vec4),
    weighted: int,
    response: wp.array(dtype=float),
    start: float,
    density: float,
    low: float,
    high: float,
    slack_low: float,
    slack_high: float,
    gain_low: float,
    gain_high: float,
    power: float,
    ridge: float,
    binary: int,
    reach: float,
    parts: wp.array(dtype=float),
    n_i: int,
    n_j: int,
    n_z: int,
    n_sample: int,
    n_part: int,
):
    slab, tile, j, lane = wp.tid()
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
                answer = respond(doses[k], response, start, density, n_sample)
                difference = answer[0] - (low + (high - low) * f)
                excess = wp.abs(difference) - (slack_low + (slack_high - slack_low) * f)
                if excess > 0.0:
                    gain = (gain_low + (gain_high - gain_low) * f) * weights[k]
                    root = root_of(excess, power)
                    result += gain * root * excess
                    slopes[k] = wp.sign(difference) * gain * power * root * answer[1]
                value = difference + low + (high - low) * f
                result += ridge * value * value
                slopes[k] = slopes[k] + 2.0 * ridge * value * answer[1]
        dose[slab, i, j, lane] = slopes
    parts[part_index(slab, tile, j, lane, n_i, n_j, dose.shape[3])] = result


@wp.kernel
def sampled_loss(
    dose: wp.array4d(dtype=wp.vec4),
    target: wp.array4d(dtype=wp.vec4),
    weight: wp.array4d(dtype=wp.vec4),
    weighted: int,
    outer: wp.array(dtype=float),
    inner: wp.array(dtype=float),
    start: float,
    density: float,
    binary: int,
    reach: float,
    parts: wp.array(dtype=float),
    n_i: int,
    n_j: int,
    n_z: int,
    n_sample: int,
    n_part: int,
):
    slab, tile, j, lane = wp.tid()
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
                answer = (1.0 - f) * respond(doses[k], outer, start, density, n_sample)
                answer += f * respond(doses[k], inner, start, density, n_sample)
                result += weights[k] * answer[0]
                slopes[k] = weights[k] * answer[1]
        dose[slab, i, j, lane] = slopes
    parts[part_index(slab, tile, j, lane, n_i, n_j, dose.shape[3])] = result
