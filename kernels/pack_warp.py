"""Warp version of `pack`; a thread owns four lanes of z."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})

START_R = 0.7548776662466927
START_Z = 0.5698402909980532


@wp.func
def place(index: int, count: int, backwards: bool):
    if backwards:
        return count - 1 - index
    return index


@wp.func
def brightness(flat: wp.array2d[float], row: int, column: int):
    if flat.shape[0] == 1 and flat.shape[1] == 1:
        return flat[0, 0]
    return flat[row, column]


@wp.func
def sample(sinogram: Vectors, angle: int, r: int, z: int, n_r: int, n_z: int):
    if r < 0 or r >= n_r or z < 0 or z >= n_z:
        return 0.0
    return slice_of(sinogram, angle, r, z)


@wp.func
def required(sinogram: Vectors, part_r: float, part_z: float, angle: int, r: int, z: int, n_r: int, n_z: int):
    light = (1.0 - part_r) * (1.0 - part_z) * sample(sinogram, angle, r, z, n_r, n_z)
    if part_r > 0.0:
        light += part_r * (1.0 - part_z) * sample(sinogram, angle, r - 1, z, n_r, n_z)
    if part_z > 0.0:
        light += (1.0 - part_r) * part_z * sample(sinogram, angle, r, z - 1, n_r, n_z)
    if part_r > 0.0 and part_z > 0.0:
        light += part_r * part_z * sample(sinogram, angle, r - 1, z - 1, n_r, n_z)
    return light


@wp.kernel
def count_light(
    sinogram: Vectors, flat: wp.array2d[float], shift_r: int, shift_z: int, part_r: float, part_z: float,
    flip_r: int, flip_z: int, drop: int, prefix: int, counts: wp.array[int],
    n_angle: int, n_r: int, n_z: int, n_flat_row: int, n_flat_column: int,
) -> None:  # fmt: skip
    slab, _, r, lane = wp.tid()
    column = place(r, n_r, flip_r != 0)
    last = int(-1)
    run = int(0)  # neighbors often share a bin; adding a run at once avoids waiting
    for angle in range(n_angle):
        for k in range(4):
            z = 4 * (slab * sinogram.shape[3] + lane) + k
            if z < n_z:
                light = required(sinogram, part_r, part_z, angle, r - shift_r, z - shift_z, n_r, n_z)
                if not (light <= 0.0):
                    full = brightness(flat, place(z, n_z, flip_z == 0), column)
                    bits = wp.cast(light / full, wp.uint32) & wp.uint32(0x7FFFFFFF)
                    if int(bits >> wp.uint32(drop + 10)) == prefix:
                        chosen = int((bits >> wp.uint32(drop)) & wp.uint32(1023))
                        if chosen != last:
                            if run > 0:
                                wp.atomic_add(counts, last, run)
                            last = chosen
                            run = 0
                        run += 1
    if run > 0:
        wp.atomic_add(counts, last, run)


@wp.func
def nearest(bounds: wp.array[float], aim: float):
    level = int(0)
    step = int(128)
    for _ in range(8):
        if aim > bounds[level + step - 1]:
            level += step
        step = step // 2
    return level


@wp.kernel
def quantize(
    sinogram: Vectors, flat: wp.array2d[float], curve: wp.array[float], bounds: wp.array[float],
    gain: float, shift_r: int, shift_z: int, part_r: float, part_z: float, flip_r: int, flip_z: int, carry: float,
    images: wp.array3d[wp.uint8],
    n_angle: int, n_r: int, n_z: int, n_flat_row: int, n_flat_column: int, n_level: int,
) -> None:  # fmt: skip
    slab, _, r, lane = wp.tid()
    column = place(r, n_r, flip_r != 0)
    black = curve[0]
    white = curve[n_level - 1]
    for k in range(4):
        z = 4 * (slab * sinogram.shape[3] + lane) + k
        if z < n_z:
            row = place(z, n_z, flip_z == 0)
            full = brightness(flat, row, column)
            start = float(row) * START_Z + float(column) * START_R
            error = carry * (start - wp.floor(start) - 0.5)
            for angle in range(n_angle):
                light = required(sinogram, part_r, part_z, angle, r - shift_r, z - shift_z, n_r, n_z) * gain / full
                aim = wp.clamp(light, black, white) + error
                level = nearest(bounds, aim)
                images[angle, row, column] = wp.uint8(level)
                if carry > 0.0:
                    error = aim - curve[level]


@wp.kernel
def fold_bits(
    images: wp.array3d[wp.uint8], folded: wp.array3d[wp.uint8],
    n_angle: int, n_z: int, n_r: int, n_byte: int,
) -> None:  # fmt: skip
    angle, row, byte = wp.tid()
    bits = int(0)
    for column in range(8 * byte, wp.min(8 * byte + 8, n_r)):
        bits += (int(images[angle, row, column]) & 1) << (7 - column % 8)
    folded[angle, row, byte] = wp.uint8(bits)


@wp.func
def shown(
    images: wp.array3d[wp.uint8], flat: wp.array2d[float], curve: wp.array[float], bits: int,
    flip_r: int, flip_z: int, angle: int, r: int, z: int, n_r: int, n_z: int,
):  # fmt: skip
    if r < 0 or r >= n_r or z < 0 or z >= n_z:
        return 0.0
    row = place(z, n_z, flip_z == 0)
    column = place(r, n_r, flip_r != 0)
    level = int(0)
    if bits == 8:
        level = int(images[angle, row, column])
    if bits == 1:
        level = (int(images[angle, row, column // 8]) >> (7 - column % 8)) & 1
    return curve[level] * brightness(flat, row, column)


@wp.kernel
def unpack(
    images: wp.array3d[wp.uint8], flat: wp.array2d[float], curve: wp.array[float], bits: int,
    scale: float, shift_r: int, shift_z: int, part_r: float, part_z: float, flip_r: int, flip_z: int, light: Vectors,
    n_angle: int, n_z: int, n_byte: int, n_flat_row: int, n_flat_column: int, n_level: int, n_r: int,
) -> None:  # fmt: skip
    slab, angle, column, lane = wp.tid()
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    r = column + shift_r
    for k in range(4):
        z = 4 * (slab * light.shape[3] + lane) + k + shift_z
        total = float(0.0)
        for more in range(4):
            more_r = more % 2
            more_z = more // 2
            weight = wp.where(more_r == 1, part_r, 1.0 - part_r) * wp.where(more_z == 1, part_z, 1.0 - part_z)
            if weight > 0.0:
                total += weight * shown(
                    images, flat, curve, bits, flip_r, flip_z, angle, r + more_r, z + more_z, n_r, n_z
                )
        result[k] = scale * total
    light[slab, angle, column, lane] = result
