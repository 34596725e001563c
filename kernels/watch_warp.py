"""Warp version of `watch`; a thread owns four lanes of z of one voxel's column, or one picked voxel."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.loss_warp import respond
from vamgpu.kernels.wide_warp import Vectors, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def pick_voxels(
    field: Vectors, places: wp.array2d[int], picked: wp.array[float], n_i: int, n_j: int, n_z: int, n_pick: int
) -> None:
    k = wp.tid()
    picked[k] = slice_of(field, places[k, 0], places[k, 1], places[k, 2])


@wp.kernel
def interpolate(
    x: Vectors, knots: wp.array[float], values: wp.array[float], out: Vectors, n_i: int, n_j: int, n_z: int, n_knot: int
) -> None:
    slab, i, j, lane = wp.tid()
    place = x[slab, i, j, lane]
    found = wp.vec4(values[0], values[0], values[0], values[0])
    for k in range(n_knot - 1):
        length = knots[k + 1] - knots[k]
        slope = (values[k + 1] - values[k]) / length
        for m in range(4):
            found[m] = found[m] + slope * wp.clamp(place[m] - knots[k], 0.0, length)
    out[slab, i, j, lane] = found


@wp.kernel
def tilted_gain(
    up: wp.array[float], aside: wp.array2d[float], level: float, along: float, across: float, gain: Vectors,
    n_z: int, n_i: int, n_j: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    even = 1.0 + across * aside[i, j]
    found = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        found[k] = level * (even + along * up[wp.min(4 * (slab * gain.shape[3] + lane) + k, n_z - 1)])
    gain[slab, i, j, lane] = found


@wp.kernel
def match_dose(
    dose: Vectors, got: Vectors, least: float, most: float, gain: Vectors, n_i: int, n_j: int, n_z: int
) -> None:
    slab, i, j, lane = wp.tid()
    planned = dose[slab, i, j, lane]
    had = got[slab, i, j, lane]
    found = gain[slab, i, j, lane]
    for k in range(4):
        if wp.min(planned[k], had[k]) > least:
            found[k] = found[k] * wp.clamp(planned[k] / had[k], 1.0 / most, most)
    gain[slab, i, j, lane] = found


@wp.kernel
def spare_voxels(
    dose: Vectors, target: Vectors, deviation: Vectors, share: float, margin: float, inside: float, greatest: float,
    weight: Vectors, n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    had = dose[slab, i, j, lane]
    spread = deviation[slab, i, j, lane]
    part = target[slab, i, j, lane]
    found = wp.vec4(1.0, 1.0, 1.0, 1.0)
    for k in range(4):
        sure = had[k] - (share * spread[k] + margin)
        if part[k] >= 0.5:
            if sure > greatest:
                found[k] = 0.0
        elif sure >= inside:
            found[k] = 0.0
    weight[slab, i, j, lane] = found


@wp.kernel
def likelihood_weights(
    dose: Vectors, seen: Vectors, deviation: Vectors, judged: wp.array2d[float], samples: wp.array[float],
    start: float, density: float, weight: Vectors, pull: Vectors, n_i: int, n_j: int, n_z: int, n_sample: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    had = dose[slab, i, j, lane]
    conversion = seen[slab, i, j, lane]
    spread = deviation[slab, i, j, lane]
    known = wp.vec4(0.0, 0.0, 0.0, 0.0)
    asked = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if judged[i, j] > 0.0:
        for k in range(4):
            if spread[k] > 0.0:
                made = respond(had[k], samples, start, density, n_sample)
                slope = made[1] * had[k]
                rate = slope / (spread[k] * spread[k])
                known[k] = rate * slope
                asked[k] = rate * (conversion[k] - made[0])
    weight[slab, i, j, lane] = known
    pull[slab, i, j, lane] = asked


@wp.kernel
def share_gain(
    pull: Vectors, weight: Vectors, least: float, shared: float, strength: float, dose: Vectors, deviation: Vectors,
    n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    had = dose[slab, i, j, lane]
    known = weight[slab, i, j, lane]
    asked = pull[slab, i, j, lane]
    spread = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        spread[k] = wp.abs(had[k]) / wp.sqrt(known[k] / shared + strength)
        had[k] = had[k] * (1.0 + asked[k] / (known[k] + least))
    deviation[slab, i, j, lane] = spread
    dose[slab, i, j, lane] = had


@wp.kernel
def conversion_deviation(
    extinction: Vectors, sharp: Vectors, rounded: Vectors, knots: wp.array[float], slopes: wp.array[float],
    model: float, variance: Vectors, n_i: int, n_j: int, n_z: int, n_knot: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    place = extinction[slab, i, j, lane]
    edge = sharp[slab, i, j, lane] - rounded[slab, i, j, lane]
    found = variance[slab, i, j, lane]
    for m in range(4):
        slope = slopes[0]
        for k in range(1, n_knot):
            if place[m] >= knots[k]:
                slope = slopes[k]
        found[m] = wp.sqrt(found[m] * slope * slope + 4.0 * edge[m] * edge[m] + model * model)
    variance[slab, i, j, lane] = found
