"""Warp version of `spectrum`; a thread owns four lanes of z, two complex numbers."""

from __future__ import annotations

from typing import Any

import warp as wp

from vamgpu.kernels.wide_warp import Flat, read, write

wp.set_module_options({"enable_backward": False, "fast_math": False})

ROWS = 8
Rows: Any = wp.types.matrix(shape=(8, 4), dtype=wp.float32)
Entry: Any = wp.types.vector(length=8, dtype=wp.float32)
OUTPUTS = 5  # samples of a transform that a thread computes at once, and the number of repetitions
MAJORS = 4
Outputs: Any = wp.types.matrix(shape=(5, 4), dtype=wp.float32)
Waves: Any = wp.types.vector(length=5, dtype=wp.float32)
Steps: Any = wp.types.vector(length=5, dtype=wp.int32)


@wp.func
def turned(x: wp.vec4):
    """i times each pair of lanes."""
    return wp.vec4(-x[1], x[0], -x[3], x[2])


@wp.func
def threads_of(bands: wp.array2d[int], g: int):
    """How many threads' work the samples of a band are."""
    return bands[g, 1] // bands[g, 3] * ((bands[g, 3] + OUTPUTS - 1) // OUTPUTS) * bands[g, 2]


@wp.func
def direct_sums(
    source: Flat, bands: wp.array2d[int], waves: wp.array2d[float], sign: float, sink: Flat, slab: int, lane: int,
    lanes: int, number: int,
):  # fmt: skip
    """OUTPUTS samples of a transform: number `number` of all."""
    own = number
    g = int(0)
    count = threads_of(bands, 0)
    while own >= count:
        own -= count
        g += 1
        if g == bands.shape[0]:
            return
        count = threads_of(bands, g)
    n = bands[g, 1]
    rings = bands[g, 2]
    radix = bands[g, 3]
    blocks = (radix + OUTPUTS - 1) // OUTPUTS
    done = bands[g, 4]
    turns = n // (done * radix)
    ring = own % rings
    block = own // rings % blocks * OUTPUTS
    group = own // rings // blocks
    inner = group % done
    start = group // done
    phase = Steps()
    step = Steps()
    for o in range(OUTPUTS):
        step[o] = (inner + wp.min(block + o, radix - 1) * done) * turns
    sample = start * done + inner
    along = Outputs()
    across = Outputs()
    for _ in range(radix):
        at = bands[g, 6] + sample % bands[g, 7] * bands[g, 8] + sample // bands[g, 7] * bands[g, 9] + ring
        given = read(source, slab, at * lanes + lane)
        c = Waves()
        s = Waves()
        for o in range(OUTPUTS):
            c[o] = waves[bands[g, 5] + phase[o], 0]
            s[o] = waves[bands[g, 5] + phase[o], 1]
            phase[o] = phase[o] + step[o]
            if phase[o] >= n:
                phase[o] = phase[o] - n
        along += wp.outer(c, given)
        across += wp.outer(s, given)
        sample += turns * done
    for o in range(OUTPUTS):
        if block + o < radix:
            out = start * done * radix + inner + (block + o) * done
            at = bands[g, 10] + out % bands[g, 11] * bands[g, 12] + out // bands[g, 11] * bands[g, 13] + ring
            write(sink, slab, at * lanes + lane, along[o] + sign * turned(across[o]))


@wp.kernel
def fourier(
    source: Flat, bands: wp.array2d[int], waves: wp.array2d[float], sign: float, first: int, second: int, third: int,
    last: int, sink: Flat, n_a: int, n_b: int, n_z: int, n_band: int, n_wave: int, n_i: int, n_j: int,
) -> None:  # fmt: skip
    slab, majors, minor, lane = wp.tid()
    lanes = source.shape[1] // (n_a * n_b)
    for m in range(MAJORS):
        number = (majors * MAJORS + m) * ((n_j + 1) // 2) + minor
        direct_sums(source, bands, waves, sign, sink, slab, lane, lanes, number)


@wp.func_native("""
    const float* at = (const float*)entries.data + start;
    wp::vec_t<8, wp::float32> out;
#if defined(__CUDA_ARCH__)
    const float4 low = __ldg((const float4*)at), high = __ldg((const float4*)at + 1);
    out[0] = low.x; out[1] = low.y; out[2] = low.z; out[3] = low.w;
    out[4] = high.x; out[5] = high.y; out[6] = high.z; out[7] = high.w;
#else
    for (int i = 0; i < 8; i++) out[i] = at[i];
#endif
    return out;
""")
def eight(entries: wp.array[float], start: int) -> Entry:  # type: ignore[empty-body]
    """Eight successive entries."""
    ...


@wp.func
def first_entry(entries: wp.array[float], k: int, n_k: int):
    """Where the entries of a frequency begin."""
    frequency = k
    if 2 * k > n_k:
        frequency = n_k - k
    return frequency * (entries.shape[0] // (n_k // 2 + 1))


@wp.func
def tile_at(tiles: wp.array2d[int], tile: int, k: int, n_k: int):
    """The tile whose entries another tile uses at a frequency."""
    if 2 * k > n_k:
        return tiles[tile, 1]
    return tile


@wp.func
def pairs_of(lit: wp.array2d[int], tile: int, k: int, n_k: int):
    """The number of pairs of columns that light the tile whose entries are used, at a frequency."""
    return lit[wp.where(2 * k > n_k, n_k - k, k), tile]


@wp.kernel
def light_rings(
    light: Flat, entries: wp.array[float], greatest: float, tiles: wp.array2d[int], lit: wp.array2d[int],
    order: wp.array3d[int], mirrored: int, tf32: int, spectrum: Flat,
    n_k: int, n_r: int, n_z: int, n_entry: int, n_tile: int, n_frequency: int, n_cell: int,
) -> None:  # fmt: skip
    two, k, tile, lane = wp.tid()
    slab = 2 * two
    if slab >= spectrum.shape[0] or k >= n_k or tile >= n_tile:
        return
    other = wp.min(slab + 1, spectrum.shape[0] - 1)
    lanes = spectrum.shape[1] // (n_k * n_cell)
    right = k * n_r * lanes + lane
    left = right + (n_r - 1) * lanes
    both = float(0.0)
    pairs = n_r
    if mirrored != 0:
        both = 1.0
        right += n_r // 2 * lanes
        left -= n_r // 2 * lanes
        pairs -= n_r // 2
    own = tile_at(tiles, tile, k, n_k)
    entry = first_entry(entries, k, n_k) + tiles[own, 0]
    real = Rows()
    imaginary = Rows()
    other_real = Rows()
    other_imaginary = Rows()
    for _ in range(wp.min(pairs_of(lit, own, k, n_k), pairs)):
        a = eight(entries, entry)
        b = eight(entries, entry + ROWS)
        x = read(light, slab, right)
        y = both * read(light, slab, left)
        other_x = read(light, other, right)
        other_y = both * read(light, other, left)
        real += wp.outer(a, x + y)
        imaginary += wp.outer(b, x - y)
        other_real += wp.outer(a, other_x + other_y)
        other_imaginary += wp.outer(b, other_x - other_y)
        entry += 2 * ROWS
        right += lanes
        left -= lanes
    sign = wp.where(2 * k > n_k, -1.0, 1.0)
    at = (k * n_cell + tile * ROWS) * lanes + lane
    for row in range(ROWS):
        write(spectrum, slab, at + row * lanes, real[row] + sign * turned(imaginary[row]))
        write(spectrum, other, at + row * lanes, other_real[row] + sign * turned(other_imaginary[row]))


@wp.func
def write_columns(light: Flat, slab: int, right: int, left: int, real: wp.vec4, difference: wp.vec4):
    """Right after left; the column's value if both are one column."""
    write(light, slab, left, real - difference)
    write(light, slab, right, real + difference)


@wp.func
def rings_at(spectrum: Flat, slab: int, at: int, lanes: int):
    """The rings of a tile."""
    rings = Rows()
    for row in range(ROWS):
        rings[row] = read(spectrum, slab, at + row * lanes)
    return rings


@wp.kernel
def gather_rings(
    spectrum: Flat, entries: wp.array[float], greatest: float, tiles: wp.array2d[int], lit: wp.array2d[int],
    order: wp.array3d[int], mirrored: int, tf32: int, light: Flat,
    n_k: int, n_cell: int, n_z: int, n_entry: int, n_tile: int, n_frequency: int, n_r: int,
) -> None:  # fmt: skip
    two, k, here, lane = wp.tid()
    slab = 2 * two
    first = here * ROWS
    lanes = light.shape[1] // (n_k * n_r)
    middle = int(0)
    if mirrored != 0:
        middle = n_r // 2
    if slab >= light.shape[0] or k >= n_k or middle + first >= n_r:
        return
    other = wp.min(slab + 1, light.shape[0] - 1)
    frequency = first_entry(entries, k, n_k)
    real = Rows()
    imaginary = Rows()
    other_real = Rows()
    other_imaginary = Rows()
    for tile in range(n_tile):
        own = tile_at(tiles, tile, k, n_k)
        if pairs_of(lit, own, k, n_k) > first:
            entry = frequency + tiles[own, 0] + 2 * ROWS * first
            at = (k * n_cell + tile * ROWS) * lanes + lane
            rings = rings_at(spectrum, slab, at, lanes)
            other_rings = rings_at(spectrum, other, at, lanes)
            for pair in range(ROWS):
                a = eight(entries, entry + 2 * ROWS * pair)
                b = eight(entries, entry + 2 * ROWS * pair + ROWS)
                real[pair] += a @ rings
                imaginary[pair] += b @ rings
                other_real[pair] += a @ other_rings
                other_imaginary[pair] += b @ other_rings
    sign = wp.where(2 * k > n_k, 1.0, -1.0)
    for pair in range(ROWS):
        right = middle + first + pair
        if right < n_r:
            left = right
            a_difference = sign * turned(imaginary[pair])
            b_difference = sign * turned(other_imaginary[pair])
            if mirrored != 0:
                left = n_r - 1 - right
                if left == right:  # it mirrors itself
                    a_difference = real[pair]
                    b_difference = other_real[pair]
            at = k * n_r * lanes + lane
            write_columns(light, slab, at + right * lanes, at + left * lanes, real[pair], a_difference)
            write_columns(light, other, at + right * lanes, at + left * lanes, other_real[pair], b_difference)
