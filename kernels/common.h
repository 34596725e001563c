// Shared by every OpenCL kernel. A field is stored as [slab][major][minor][LANES]; a work item owns VECTORS vectors of
// WIDTH lanes, and THREADS neighboring items share a slab: LANES = WIDTH * VECTORS * THREADS.
#define UNROLL _Pragma("unroll")

#ifdef LANES

#define PASTE_(a, b) a##b
#define PASTE(a, b) PASTE_(a, b)
typedef PASTE(float, WIDTH) Vector;

// An item already consists of vectors: without the hint, compilers for CPUs pack several items into lanes, which takes
// most of their time, and run items with different work in step.
#define FIELD_KERNEL __kernel __attribute__((vec_type_hint(Vector))) void

#define EACH_VECTOR UNROLL for (int v = 0; v < VECTORS; v++)

#define LOAD(pointer) (*(__global const Vector *)((pointer) + v * WIDTH))
#define STORE(pointer, value) (*(__global Vector *)((pointer) + v * WIDTH) = (value))

// Which samples this item computes: tile indices along major and minor, the slab, and its first lane.
#define ITEM_MINOR ((int)get_global_id(0) / THREADS)
#define ITEM_MAJOR ((int)get_global_id(1))
#define ITEM_SLAB ((int)get_global_id(2) * TILE_SLABS)
#define ITEM_LANE ((int)(get_global_id(0) % THREADS) * WIDTH * VECTORS)
#define ITEM_Z (ITEM_SLAB * LANES + ITEM_LANE)      // its first slice
#define ITEM_LANES (WIDTH * VECTORS)                // and their number

// Position of sample (major, minor) of this item's slab and lanes in a field with n_major x n_minor samples.
static inline size_t slab_offset(int n_major, int n_minor) {
    return (size_t)ITEM_SLAB * n_major * n_minor * LANES + ITEM_LANE;
}
#define SAMPLE(major, minor, n_minor) (((size_t)(major) * (n_minor) + (minor)) * LANES)

// The samples along minor, of n, that this item computes: TILE_MINOR of them, or all if that is 0.
#define MINOR_BEGIN (TILE_MINOR ? ITEM_MINOR * TILE_MINOR : 0)
#define MINOR_END(n) (TILE_MINOR ? min(MINOR_BEGIN + TILE_MINOR, n) : n)
#define EACH_MINOR(k, n) for (int k = MINOR_BEGIN, k##_end = MINOR_END(n); k < k##_end; k++)

#endif

// Position of slice z of sample (major, minor) in a field with n_major x n_minor samples and slabs of `lanes` slices.
static inline size_t slice_offset(int major, int minor, int z, int n_major, int n_minor, int lanes) {
    return (((size_t)(z / lanes) * n_major + major) * n_minor + minor) * lanes + z % lanes;
}
