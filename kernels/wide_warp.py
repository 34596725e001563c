"""Fields in the form for Warp kernels, and reading four lanes of one at once."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

Vectors = wp.array4d[wp.vec4]  # a field: [slab, major, minor, lane]
Flat = wp.array2d[wp.vec4]  # a field, flat per slab: [slab, sample · lane]


READ_WIDE = """
#if defined(__CUDA_ARCH__)
    const float4 wide = *(const float4*)at;
    return wp::vec4(wide.x, wide.y, wide.z, wide.w);
#else
    return *(const wp::vec4*)at;
#endif
"""
"""End of a native function: four floats at the address ``at``."""


@wp.func_native(
    "const char* at = (const char*)field.data + (size_t)slab * field.strides[0] + (size_t)index * 16;" + READ_WIDE
)
def read(field: Flat, slab: int, index: int) -> wp.vec4:  # type: ignore[empty-body]
    ...


@wp.func_native("""
    char* at = (char*)field.data + (size_t)slab * field.strides[0] + (size_t)index * 16;
#if defined(__CUDA_ARCH__)
    *(float4*)at = make_float4(value[0], value[1], value[2], value[3]);
#else
    *(wp::vec4*)at = value;
#endif
""")
def write(field: Flat, slab: int, index: int, value: wp.vec4): ...


@wp.func_native("""
    const char* at = (const char*)field.data + (size_t)slab * field.strides[0] + (size_t)index * 16;
    return ((const float*)at)[k];
""")
def read_one(field: Flat, slab: int, index: int, k: int) -> float:  # type: ignore[empty-body]
    ...


@wp.func
def four_slabs(first: int, slabs: int):
    """Slabs of a thread; beyond the last one they repeat it."""
    return wp.vec4i(
        wp.min(first, slabs - 1),
        wp.min(first + 1, slabs - 1),
        wp.min(first + 2, slabs - 1),
        wp.min(first + 3, slabs - 1),
    )


@wp.func
def write_four(field: Flat, slabs: wp.vec4i, index: int, a: wp.vec4, b: wp.vec4, c: wp.vec4, d: wp.vec4):
    write(field, slabs[0], index, a)
    write(field, slabs[1], index, b)
    write(field, slabs[2], index, c)
    write(field, slabs[3], index, d)


@wp.func
def slice_of(field: Vectors, major: int, minor: int, z: int):
    """Slice z of a sample: neighbors in z are in one slab, or in the next."""
    lanes = 4 * field.shape[3]
    vector = field[z // lanes, major, minor, (z % lanes) // 4]
    return vector[z % 4]


@wp.func
def real_lanes(slab: int, lane: int, n_lane: int, n_z: int):
    """The number of a thread's four lanes that are slices of the field."""
    return wp.clamp(n_z - 4 * (slab * n_lane + lane), 0, 4)
