"""Warp siblings of `footprint`; a thread owns four lanes in each of two slabs of a tile of four samples.

Footprints cost more than the lanes they serve: on a GPU the threads of a block that share a tile and differ in z alone
work out those of the next poses (or planes) together, and all read them from shared memory. Fields come flat per slab.
"""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat, read, write

wp.set_module_options({"enable_backward": False, "fast_math": True})

WINDOW = wp.constant(10)  # samples of a row that a tile looks at together
TAIL = wp.constant(2.75)
FAR = wp.constant(4.0)
FADE = wp.constant(0.25)
SHARP = wp.constant(1.0e-3)
THINNEST = wp.constant(0.05)
BLURRED = wp.constant(0.2)

Place = wp.types.vector(length=6, dtype=int)  # block of slabs, major and minor tile, lane; member and tile in the block
Ray = wp.types.vector(length=5, dtype=float)  # column; half sum and half difference of the boxes; gain; reach


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return 1;
#else
    return 0;
#endif
""")
def is_shared() -> int:  # type: ignore[empty-body]
    """Whether threads of a block can share what they find."""
    ...


@wp.func
def block_of(lanes: int, blocks: int, majors: int, minors: int):
    """Tiles of a block along (slab, major, minor), as declared and launched; one where nothing is shared."""
    if is_shared() == 0:
        return wp.vec3i(1, 1, 1)
    return wp.vec3i(wp.min(4, blocks), majors, wp.max(minors // lanes, 1))


@wp.func
def place(size: wp.vec3i, lanes: int, majors: int, minors: int, here: wp.vec4i):
    """Where a thread works, so that a block is a box of tiles; of those that share a tile it is a member."""
    flat = ((here[0] * majors + here[1]) * minors + here[2]) * lanes + here[3]
    threads = size[0] * size[1] * size[2] * lanes
    box = flat // threads
    inside = flat % threads
    lane = inside % lanes
    tile = inside // lanes
    columns = minors // size[2]
    rows = majors // size[1]
    return Place(
        box // (rows * columns) * size[0] + tile // (size[1] * size[2]),
        box // columns % rows * size[1] + tile // size[2] % size[1],
        box % columns * size[2] + tile % size[2],
        lane,
        wp.where(is_shared() == 1, tile // (size[1] * size[2]) * lanes + lane, 0),
        tile % (size[1] * size[2]),
    )


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __shared__ __align__(16) float table[12 * 128 * 4];  // [row][tile and turn][component]
    float* at = table + (row * 128 + slot) * 4;
    if (component >= 0) {
        at[component] = value[0];
        return value;
    }
    const float4 found = *(const float4*)at;
    return wp::vec4(found.x, found.y, found.z, found.w);
#else
    static float table[12][4];  // there is one thread
    if (component >= 0) {
        table[row][component] = value[0];
        return value;
    }
    return wp::vec4(table[row][0], table[row][1], table[row][2], table[row][3]);
#endif
""")
def kept(row: int, slot: int, component: int, value: wp.vec4) -> wp.vec4:  # type: ignore[empty-body]
    """What a tile keeps of one turn: a component is stored, or with component −1 all four are read."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
""")
def synchronize():
    """Wait for the threads of the block."""
    ...


@wp.func
def store(row: int, slot: int, component: int, value: float):
    kept(row, slot, component, wp.vec4(value, 0.0, 0.0, 0.0))


@wp.func
def load(row: int, slot: int):
    return kept(row, slot, -1, wp.vec4(0.0, 0.0, 0.0, 0.0))


@wp.func_native("""
    const char* at = (const char*)light.data + (size_t)i * light.strides[0] + (size_t)j * 16;
#if defined(__CUDA_ARCH__)
    const float4 wide = *(const float4*)at;
    return wp::vec4(wide.x, wide.y, wide.z, wide.w);
#else
    return *(const wp::vec4*)at;
#endif
""")
def node(light: wp.array3d(dtype=float), i: int, j: int) -> wp.vec4:  # type: ignore[empty-body]
    """A sample of the map, in one load."""
    ...


@wp.func
def third_integral(x: float, sigma: float, inverse_sigma: float):
    above = wp.max(x, 0.0)
    if sigma == 0.0:
        return 0.5 * above * above
    t = wp.abs(x) * inverse_sigma
    series = t * 7.122526186e-05 + 2.423642034e-04
    series = t * series + 3.491863407e-03
    series = t * series + 2.202380776e-02
    series = t * series + 9.973836443e-02
    series = t * series + 1.0
    series = series * series
    series = series * series
    series = series * series
    series = series * series
    square = sigma * sigma
    tail = 0.25 * square / series
    if x > 0.0:
        return 0.5 * (x * x + square) - tail
    return tail


@wp.func
def edge(x: float, outer: float, inner: float, sigma: float, inverse_sigma: float):
    """Integral of the voxel's blurred trapezoid from −∞ to x, times the areas of its boxes."""
    return (
        third_integral(x + outer, sigma, inverse_sigma) + third_integral(x - outer, sigma, inverse_sigma)
    ) - (third_integral(x + inner, sigma, inverse_sigma) + third_integral(x - inner, sigma, inverse_sigma))


@wp.func
def footprint(
    light: wp.array3d(dtype=float), n_across: int, n_along: int, n_r: int, c: float, s: float, x: float, y: float,
    bent: int, ratio: float, strength: float, fill: float, sigma: float,
):  # fmt: skip
    """Column and footprint of one voxel at one pose."""
    u = (y * c - x * s) * ratio + 0.5 * float(n_r - 1)
    gain = strength
    by_across = ratio
    by_along = float(0.0)
    if bent != 0:
        across = y * c - x * s + 0.5 * float(n_across - 1)
        along = -x * c - y * s + 0.5 * float(n_along - 1)
        i = wp.clamp(int(across), 0, n_across - 2)
        j = wp.clamp(int(along), 0, n_along - 2)
        q = along - float(j)
        near = node(light, i, j)
        near += q * (node(light, i, j + 1) - near)
        far = node(light, i + 1, j)
        far += q * (node(light, i + 1, j + 1) - far)
        ray = near + (across - float(i)) * (far - near)
        u = ray[0]
        gain = ray[1]
        by_across = ray[2]
        by_along = ray[3]
    a = wp.abs(by_across * s + by_along * c)
    b = wp.abs(by_across * c - by_along * s)
    least = THINNEST + BLURRED * sigma
    thin = wp.max(wp.min(a, b), least)
    wide = wp.sqrt(wp.max(a * a + b * b - thin * thin, least * least))
    outer = 0.5 * (wide + thin)
    reach = wp.max(outer + 0.5 * fill + TAIL * sigma, FAR * sigma)
    return Ray(u, outer, 0.5 * (wide - thin), gain / (wide * thin * fill), reach)


@wp.func
def faded(distance: float, reach: float, sigma: float):
    """How much of a share counts: all but near the end of its reach."""
    return wp.clamp((reach - wp.abs(distance)) / (FADE * sigma + SHARP), 0.0, 1.0)


@wp.func
def rounded(n: int, multiple: int):
    return (n + multiple - 1) // multiple * multiple


@wp.func
def voxel(x: int, n: int):
    return float(x) - 0.5 * float(n - 1)


@wp.func
def columns_of(slot: int, skip: int, n_r: int):
    """First column of a tile's window, leaving out `skip`, and how many."""
    begin = wp.max(int(wp.min(load(WINDOW, slot))), 0) + skip
    final = wp.min(int(wp.max(load(WINDOW + 1, slot))), n_r - 1)
    return wp.vec2i(begin, wp.clamp(final - begin + 1, 0, WINDOW))


@wp.kernel(launch_bounds=(256, 3))
def back_footprint(
    sinogram: Flat, directions: wp.array2d(dtype=float), light: wp.array3d(dtype=float), bent: int, ratio: float,
    strength: float, fill: float, sigma: float, radius: float, taps: int, volume: Flat,
    n_angle: int, n_r: int, n_z: int, n_across: int, n_along: int, n_x: int, n_y: int,
):  # fmt: skip
    i0, i1, i2, i3 = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    size = block_of(lanes, (volume.shape[0] + 1) // 2, 1, 64)
    minors = rounded((n_y + 1) // 2, size[2])
    here = place(size, lanes, rounded((n_x + 1) // 2, size[1]), minors, wp.vec4i(i0, i1, i2, i3))
    lane = here[3]
    s0 = wp.min(2 * here[0], volume.shape[0] - 1)  # surplus slabs repeat the last one there is
    s1 = wp.min(2 * here[0] + 1, volume.shape[0] - 1)
    row = 2 * here[1]
    column = 2 * here[2]
    members = wp.where(is_shared() == 1, size[0] * lanes, 1)
    at_once = wp.where(is_shared() == 1, wp.min(8, 128 // (size[1] * size[2])), 1)
    first_slot = here[5] * at_once
    inverse_sigma = wp.where(sigma > 0.0, 1.0 / wp.max(sigma, 1.0e-9), 0.0)
    widest = taps + int(1.4143 * ratio) + 1  # columns of a tile, at most
    t0 = wp.mat44(0.0)
    t1 = wp.mat44(0.0)
    for first_pose in range(0, n_angle, at_once):
        poses = wp.min(at_once, n_angle - first_pose)
        synchronize()
        for work in range(here[4], 4 * poses, members):
            i = work % 4
            pose = first_pose + work // 4
            x = voxel(row + i // 2, n_x)
            y = voxel(column + i % 2, n_y)
            ray = footprint(
                light, n_across, n_along, n_r, directions[pose, 0], directions[pose, 1], x, y, bent, ratio, strength,
                fill, sigma,
            )  # fmt: skip
            is_lit = x * x + y * y <= radius * radius
            store(WINDOW, first_slot + work // 4, i, wp.where(is_lit, wp.ceil(ray[0] - ray[4]), 1.0e6))
            store(WINDOW + 1, first_slot + work // 4, i, wp.where(is_lit, wp.floor(ray[0] + ray[4]), -1.0e6))
        for skip in range(0, widest, WINDOW):
            synchronize()
            for work in range(here[4], 4 * poses, members):
                i = work % 4
                turn = work // 4
                window = columns_of(first_slot + turn, skip, n_r)
                if window[1] > 0:
                    first = load(WINDOW, first_slot + turn)[i]
                    final = load(WINDOW + 1, first_slot + turn)[i]
                    pose = first_pose + turn
                    ray = footprint(
                        light, n_across, n_along, n_r, directions[pose, 0], directions[pose, 1],
                        voxel(row + i // 2, n_x), voxel(column + i % 2, n_y), bent, ratio, strength, fill, sigma,
                    )  # fmt: skip
                    above = float(0.0)
                    fresh = int(1)  # whether the integral up to this column's upper edge is yet to be found
                    for k in range(window[1]):
                        at = float(window[0] + k)
                        distance = ray[0] - at
                        weight = float(0.0)
                        if at >= first and at <= final:
                            if fresh == 1:
                                above = edge(distance + 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
                            below = edge(distance - 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
                            weight = faded(distance, ray[4], sigma) * ray[3] * wp.max(above - below, 0.0)
                            above = below
                            fresh = wp.where(fill != 1.0, 1, 0)
                        store(k, first_slot + turn, i, weight)
            synchronize()
            for turn in range(poses):
                window = columns_of(first_slot + turn, skip, n_r)
                index = ((first_pose + turn) * n_r + window[0]) * lanes + lane
                for k in range(window[1]):
                    weights = load(k, first_slot + turn)
                    t0 += wp.outer(weights, read(sinogram, s0, index))
                    t1 += wp.outer(weights, read(sinogram, s1, index))
                    index += lanes
    for i in range(4):
        if row + i // 2 < n_x and column + i % 2 < n_y:
            at_voxel = ((row + i // 2) * n_y + column + i % 2) * lanes + lane
            write(volume, s0, at_voxel, t0[i])
            write(volume, s1, at_voxel, t1[i])


@wp.func
def line(
    edges: wp.array2d(dtype=float), r: int, side: int, c0: float, s0: float, along_y: int, planes_middle: float,
    cells_middle: float,
):  # fmt: skip
    """Where a chord turned to one pose crosses plane 0, and how far it drifts from plane to plane."""
    p = edges[r, side]
    c = c0 * edges[r, side + 1] - s0 * edges[r, side + 2]
    s = s0 * edges[r, side + 1] + c0 * edges[r, side + 2]
    if along_y == 1:
        return wp.vec2(-p / s - planes_middle * c / s + cells_middle, c / s)
    return wp.vec2(p / c - planes_middle * s / c + cells_middle, s / c)


@wp.func
def cells_of(low: wp.vec2, high: wp.vec2, slack: float, plane: int, row_cells: int, skip: int):
    """First cell of a plane, leaving out `skip`, and how many from there on, a window at most."""
    a = low[0] + float(plane) * low[1]
    b = high[0] + float(plane) * high[1]
    begin = wp.max(int(wp.ceil(wp.min(a, b) - slack)), 0) + skip
    final = wp.min(int(wp.floor(wp.max(a, b) + slack)), row_cells - 1)
    return wp.vec2i(begin, wp.clamp(final - begin + 1, 0, WINDOW))


@wp.kernel(launch_bounds=(512, 2))
def forward_footprint(
    volume: Flat, directions: wp.array2d(dtype=float), light: wp.array3d(dtype=float), edges: wp.array2d(dtype=float),
    bent: int, ratio: float, strength: float, fill: float, sigma: float, radius: float, taps: int, cells: int,
    sinogram: Flat,
    n_x: int, n_y: int, n_z: int, n_angle: int, n_across: int, n_along: int, n_r: int,
):  # fmt: skip
    i0, i1, i2, i3 = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    size = block_of(lanes, (volume.shape[0] + 1) // 2, 4, 32)
    minors = rounded((n_r + 3) // 4, size[2])
    here = place(size, lanes, rounded(n_angle, size[1]), minors, wp.vec4i(i0, i1, i2, i3))
    lane = here[3]
    s0 = wp.min(2 * here[0], volume.shape[0] - 1)
    s1 = wp.min(2 * here[0] + 1, volume.shape[0] - 1)
    angle = wp.min(here[1], n_angle - 1)
    r = 4 * here[2]
    near_r = wp.min(r, n_r - 1)
    members = wp.where(is_shared() == 1, size[0] * lanes, 1)
    at_once = wp.where(is_shared() == 1, wp.min(8, 128 // (size[1] * size[2])), 1)
    first_slot = here[5] * at_once
    inverse_sigma = wp.where(sigma > 0.0, 1.0 / wp.max(sigma, 1.0e-9), 0.0)
    c = directions[angle, 0]
    s = directions[angle, 1]
    final_r = wp.min(r + 3, n_r - 1)
    # the chord's own direction decides which planes it crosses most steeply
    cos_d = edges[near_r, 1]
    sin_d = edges[near_r, 2]
    along_y = wp.where(wp.abs(s * cos_d + c * sin_d) > wp.abs(c * cos_d - s * sin_d), 1, 0)
    planes = wp.where(along_y == 1, n_y, n_x)
    row_cells = wp.where(along_y == 1, n_x, n_y)
    low = line(edges, near_r, 0, c, s, along_y, 0.5 * float(planes - 1), 0.5 * float(row_cells - 1))
    high = line(edges, final_r, 4, c, s, along_y, 0.5 * float(planes - 1), 0.5 * float(row_cells - 1))
    slack = float(0.0)
    for beside in range(near_r, final_r + 1):
        slack = wp.max(slack, edges[beside, 3])
    step = wp.where(along_y == 1, n_y * lanes, lanes)
    t0 = wp.mat44(0.0)
    t1 = wp.mat44(0.0)
    for first_plane in range(0, wp.max(n_x, n_y), at_once):
        for skip in range(0, cells, WINDOW):
            synchronize()
            for work in range(here[4], at_once * WINDOW, members):
                turn = work // WINDOW
                k = work % WINDOW
                plane = first_plane + turn
                window = cells_of(low, high, slack, plane, row_cells, skip)
                if plane < planes and k < window[1] and r < n_r:
                    x = voxel(wp.where(along_y == 1, window[0] + k, plane), n_x)
                    y = voxel(wp.where(along_y == 1, plane, window[0] + k), n_y)
                    ray = footprint(light, n_across, n_along, n_r, c, s, x, y, bent, ratio, strength, fill, sigma)
                    gain = wp.where(x * x + y * y <= radius * radius, ray[3], 0.0)
                    above = edge(ray[0] - float(r) + 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
                    for i in range(4):
                        distance = ray[0] - float(r + i)
                        below = edge(distance - 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
                        weight = faded(distance, ray[4], sigma) * gain * wp.max(above - below, 0.0)
                        store(k, first_slot + turn, i, weight)
                        above = below
                        if fill != 1.0:
                            above = edge(distance - 1.0 + 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
            synchronize()
            for turn in range(wp.min(at_once, planes - first_plane)):
                plane = first_plane + turn
                window = cells_of(low, high, slack, plane, row_cells, skip)
                index = wp.where(along_y == 1, window[0] * n_y + plane, plane * n_y + window[0]) * lanes + lane
                for k in range(window[1]):
                    weights = load(k, first_slot + turn)
                    t0 += wp.outer(weights, read(volume, s0, index))
                    t1 += wp.outer(weights, read(volume, s1, index))
                    index += step
    for i in range(4):
        if r + i < n_r and here[1] < n_angle:
            at_column = (angle * n_r + r + i) * lanes + lane
            write(sinogram, s0, at_column, t0[i])
            write(sinogram, s1, at_column, t1[i])
