"""Tiles of samples whose shares several threads compute together and all apply, in Warp."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat, four_slabs

wp.set_module_options({"enable_backward": False, "fast_math": True})

SAMPLES = 128  # greatest number, per tile, whose shares are kept at a time
KEPT = 1024  # by all tiles of a block
TURNS = 16  # greatest number at a time


@wp.struct
class Tile:
    """Position of a thread, and the place where its tile keeps the data that its members share."""

    slabs: wp.vec4i
    major: int
    minor: int
    lane: int
    member: int
    members: int
    samples: int  # greatest number that it may keep
    slots: int  # first of its samples
    windows: int  # first and number of those of its first turn


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return 1;
#else
    return 0;
#endif
""")
def is_shared() -> int:  # type: ignore[empty-body]
    """Whether threads of a block can share their results."""
    ...


@wp.func
def rounded(n: int, multiple: int):
    return (n + multiple - 1) // multiple * multiple


@wp.func
def tile_of(slabs: int, lanes: int, majors: int, minors: int, n_major: int, n_minor: int, here: wp.vec4i):
    """Position of a thread: a block is a box of tiles, and the members of a tile follow each other."""
    size = wp.vec3i(1, 1, 1)  # tiles of a block along (slab, major, minor)
    if is_shared() == 1:
        size = wp.vec3i(wp.min(4, (slabs + 3) // 4), majors, wp.max(minors // lanes, 1))
    all_majors = rounded(n_major, size[1])
    all_minors = rounded(n_minor, size[2])
    flat = ((here[0] * all_majors + here[1]) * all_minors + here[2]) * lanes + here[3]
    members = size[0] * lanes
    tiles = size[1] * size[2]
    box = flat // (members * tiles)
    tile = flat // members % tiles
    member = flat % members
    columns = all_minors // size[2]
    rows = all_majors // size[1]
    block = 4 * (box // (rows * columns) * size[0] + member // lanes)
    at = Tile()
    at.slabs = four_slabs(block, slabs)
    at.major = box // columns % rows * size[1] + tile // size[2]
    at.minor = box % columns * size[2] + tile % size[2]
    at.lane = member % lanes
    at.samples = wp.min(SAMPLES, KEPT // tiles)
    at.slots = tile * (at.samples + 1)
    if is_shared() == 1:
        at.member = member
        at.members = members
        at.windows = KEPT + SAMPLES + 2 * TURNS * tile
    else:
        at.member = 0
        at.members = 1
        at.windows = SAMPLES + 1
    return at


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __shared__ __align__(16) float table[(1024 + 128) * 4];
#else
    static float table[129 * 4];  // there is one thread
#endif
    float* at = table + slot * 4;
    if (component >= 0) at[component] = value[0];
#if defined(__CUDA_ARCH__)
    if (component == -2) *(float4*)at = make_float4(value[0], value[1], value[2], value[3]);
    if (component != -1) return value;
    const float4 found = *(const float4*)at;
    return wp::vec4(found.x, found.y, found.z, found.w);
#else
    if (component == -2) for (int i = 0; i < 4; i++) at[i] = value[i];
    if (component != -1) return value;
    return wp::vec4(at[0], at[1], at[2], at[3]);
#endif
""")
def share(slot: int, component: int, value: wp.vec4) -> wp.vec4:  # type: ignore[empty-body]
    """Four shares of a sample: all are read with component −1 and stored with −2, or one is stored."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __shared__ int table[1024 + 128 + 2 * 16 * 64];
#else
    static int table[129 + 2 * 16];
#endif
    if (stored) table[slot] = value;
    return table[slot];
""")
def number(slot: int, stored: bool, value: int) -> int:  # type: ignore[empty-body]
    """Position of a sample and, behind those of all tiles, the first sample of each turn and their number."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    if (32 % members == 0) {
        const unsigned lane = threadIdx.x & 31;
        __syncwarp(members == 32 ? 0xffffffffu : ((1u << members) - 1u) << (lane / members * members));
    } else {
        __syncthreads();
    }
#endif
""")
def meet(members: int):
    """Wait for the threads of the tile, or of the block if they are not in one warp."""
    ...


@wp.func_native("""
    return (wp::uint64)((const char*)field.data + (size_t)slab * field.strides[0] + lane * 16);
""")
def start(field: Flat, slab: int, lane: int) -> wp.uint64:  # type: ignore[empty-body]
    """Address of a lane in a slab."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const float4 wide = __ldg((const float4*)slab + index);
    return wp::vec4(wide.x, wide.y, wide.z, wide.w);
#else
    return *((const wp::vec4*)slab + index);
#endif
""")
def fetch(slab: wp.uint64, index: int) -> wp.vec4:  # type: ignore[empty-body]
    """Four lanes of a slab that is only read."""
    ...


@wp.func
def samples_before(windows: int, turn: int):
    """The number of samples of the turns before one."""
    count = int(0)
    for before in range(turn):
        count += number(windows + 2 * before + 1, False, 0)
    return count


@wp.func
def no_sums():
    """The sums of four slabs before any sample is added."""
    return wp.mat44(0.0), wp.mat44(0.0), wp.mat44(0.0), wp.mat44(0.0)


@wp.func
def gathered(
    t0: wp.mat44, t1: wp.mat44, t2: wp.mat44, t3: wp.mat44, field: Flat, at: Tile, count: int,
):  # fmt: skip
    """Add the stored samples to the sums of four slabs; each sample is fetched while the previous one is added."""
    slab0 = start(field, at.slabs[0], at.lane)
    slab1 = start(field, at.slabs[1], at.lane)
    slab2 = start(field, at.slabs[2], at.lane)
    slab3 = start(field, at.slabs[3], at.lane)
    slots = at.slots
    if count > 0:
        index = number(slots, False, 0)
        a0 = fetch(slab0, index)
        a1 = fetch(slab1, index)
        a2 = fetch(slab2, index)
        a3 = fetch(slab3, index)
        if count % 2 == 1:  # pad to an even count with a sample of weight zero
            share(slots + count, -2, wp.vec4(0.0))
            number(slots + count, True, index)
        for k in range(0, count, 2):
            index = number(slots + k + 1, False, 0)
            b0 = fetch(slab0, index)
            b1 = fetch(slab1, index)
            b2 = fetch(slab2, index)
            b3 = fetch(slab3, index)
            shares = share(slots + k, -1, wp.vec4(0.0))
            t0 += wp.outer(shares, a0)
            t1 += wp.outer(shares, a1)
            t2 += wp.outer(shares, a2)
            t3 += wp.outer(shares, a3)
            index = number(slots + wp.min(k + 2, count - 1), False, 0)
            a0 = fetch(slab0, index)
            a1 = fetch(slab1, index)
            a2 = fetch(slab2, index)
            a3 = fetch(slab3, index)
            shares = share(slots + k + 1, -1, wp.vec4(0.0))
            t0 += wp.outer(shares, b0)
            t1 += wp.outer(shares, b1)
            t2 += wp.outer(shares, b2)
            t3 += wp.outer(shares, b3)
    return t0, t1, t2, t3
