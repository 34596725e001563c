// Shared by every OpenCL kernel. A field is stored as [slab][major][minor][LANES]; a work item owns VECTORS vectors of
// WIDTH lanes, and THREADS neighbouring items share a slab: LANES = WIDTH * VECTORS * THREADS.
#ifdef LANES

#define PASTE_(a, b) a##b
#define PASTE(a, b) PASTE_(a, b)
typedef PASTE(float, WIDTH) Vector;

// An item is made of vectors already: without the hint compilers for CPUs pack several items into lanes, which takes most
// of their time, and runs items in step that have unlike work.
#define FIELD_KERNEL __kernel __attribute__((vec_type_hint(Vector))) void

#define UNROLL _Pragma("unroll")
#define EACH_VECTOR UNROLL for (int v = 0; v < VECTORS; v++)

#define LOAD(pointer) (*(__global const Vector *)((pointer) + v * WIDTH))
#define STORE(pointer, value) (*(__global Vector *)((pointer) + v * WIDTH) = (value))

// Which samples this item computes: tile indices along major and minor, the slab, and its first lane.
#define ITEM_MINOR ((int)get_global_id(0) / THREADS)
#define ITEM_MAJOR ((int)get_global_id(1))
#define ITEM_SLAB ((int)get_global_id(2) * TILE_SLABS)
#define ITEM_LANE ((int)(get_global_id(0) % THREADS) * WIDTH * VECTORS)
#define ITEM_INDEX ((get_global_id(2) * get_global_size(1) + get_global_id(1)) * get_global_size(0) + get_global_id(0))

// Where sample (major, minor) of this item's slab and lanes lies in a field with n_major x n_minor samples.
static inline size_t slab_offset(int n_major, int n_minor) {
    return (size_t)ITEM_SLAB * n_major * n_minor * LANES + ITEM_LANE;
}
#define SAMPLE(major, minor, n_minor) (((size_t)(major) * (n_minor) + (minor)) * LANES)

#endif
