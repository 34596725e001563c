// Footprints on a GPU: those of a tile of four samples, computed by the items that share it.
typedef float Real;
#include "footprint.h"

// Items that differ only in z share a tile of samples and follow each other in a group. Footprints take longer than the
// lanes that use them: these items therefore compute those of the next angles (or planes) together in local memory.
#define MEMBERS (THREADS * (int)get_local_size(2))
#define TILES ((int)(get_local_size(0) / THREADS * get_local_size(1)))
typedef struct {
    int slab, major, minor, lane;       // what the item computes
    int tile, member;                   // its tile in the group, and which of the items that share the tile it is
} Place;

static inline Place place(void) {
    const int minors = get_local_size(0) / THREADS;
    const int item = get_local_id(0) + get_local_size(0) * (get_local_id(1) + get_local_size(1) * get_local_id(2));
    Place at;
    at.tile = item / MEMBERS;
    at.member = item % MEMBERS;
    at.slab = (int)(get_group_id(2) * get_local_size(2) + at.member / THREADS) * TILE_SLABS;
    at.major = get_group_id(1) * get_local_size(1) + at.tile / minors;
    at.minor = get_group_id(0) * minors + at.tile % minors;
    at.lane = at.member % THREADS * WIDTH;
    return at;
}

// Whether the items of a tile run in lockstep, as 32 do on NVIDIA's GPUs; they then wait only for each other.
#ifdef __NV_CL_C_VERSION
#define ALONE (MEMBERS == 32)
#else
#define ALONE false
#endif
static inline void meet(void) {
#ifdef __NV_CL_C_VERSION
    if (ALONE) {
        __asm__ volatile("bar.warp.sync 0xffffffff;" ::: "memory");
        return;
    }
#endif
    barrier(CLK_LOCAL_MEM_FENCE);
}

// Start of an item's lane of slab ``s`` in a field; the surplus slabs of the last item repeat the last slab.
static inline size_t lane_of(Place at, int s, int n_major, int n_minor, int n_z) {
    return (size_t)min(at.slab + s, (n_z - 1) / LANES) * n_major * n_minor * LANES + at.lane;
}

// Column, strength and footprint of one voxel at one angle.
static inline Foot footprint(__global const float4 *restrict light, int n_across, int n_along, int n_r, float3 direction,
                             float x, float y, int bent, float ratio, float strength, float fill, float sigma, float *u) {
    float4 ray = (float4)((y * direction.x - x * direction.y) * ratio + 0.5f * (n_r - 1), strength, ratio, 0.0f);
    if (bent) ray = look_up(light, n_across, n_along, direction.xy, x, y);
    *u = ray.x;
    return foot_of(fabs(ray.z * direction.y + ray.w * direction.x), fabs(ray.z * direction.x - ray.w * direction.y),
                   swept(ray.zw, direction, x, y), ray.y, fill, sigma);
}

// Adds ``count`` samples; each is fetched while the previous one is added. ``shares`` and ``indices`` have one more.
static inline void gather(Vector sum[TILE_SLABS][4], __global const float *from[TILE_SLABS], __local float4 *shares,
                          __local int *indices, int count) {
    if (count == 0) return;
    if (count % 2) {
        shares[count] = (float4)(0.0f);
        indices[count] = indices[0];
    }
    Vector even[TILE_SLABS], odd[TILE_SLABS];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) even[s] = *(__global const Vector *)(from[s] + indices[0]);
    for (int k = 0; k < count; k += 2) {
        const int after = indices[k + 1], then = indices[min(k + 2, count - 1)];
        UNROLL for (int s = 0; s < TILE_SLABS; s++) odd[s] = *(__global const Vector *)(from[s] + after);
        const float4 share = shares[k];
        UNROLL for (int s = 0; s < TILE_SLABS; s++) {
            sum[s][0] = fma((Vector)(share.x), even[s], sum[s][0]);
            sum[s][1] = fma((Vector)(share.y), even[s], sum[s][1]);
            sum[s][2] = fma((Vector)(share.z), even[s], sum[s][2]);
            sum[s][3] = fma((Vector)(share.w), even[s], sum[s][3]);
        }
        UNROLL for (int s = 0; s < TILE_SLABS; s++) even[s] = *(__global const Vector *)(from[s] + then);
        const float4 next = shares[k + 1];
        UNROLL for (int s = 0; s < TILE_SLABS; s++) {
            sum[s][0] = fma((Vector)(next.x), odd[s], sum[s][0]);
            sum[s][1] = fma((Vector)(next.y), odd[s], sum[s][1]);
            sum[s][2] = fma((Vector)(next.z), odd[s], sum[s][2]);
            sum[s][3] = fma((Vector)(next.w), odd[s], sum[s][3]);
        }
    }
}

// The samples that a tile keeps at a time; for each turn (an angle or plane), the first and their number.
// Together less than the 32 KB that every GPU has.
#define MOST_TILES 64               // of a group as declared, 8 x 8 or 16 x 4
#define DECLARE_KEPT \
    __local float4 kept_shares[KEPT + SAMPLES]; \
    __local int kept_indices[KEPT + SAMPLES]; \
    __local int2 kept_windows[TURNS * MOST_TILES]; \
    const int samples = min(SAMPLES, KEPT / TILES); \
    __local float4 *shares = kept_shares + at.tile * (samples + 1); \
    __local int *indices = kept_indices + at.tile * (samples + 1); \
    __local int2 *windows = kept_windows + at.tile * TURNS

// Number of samples of the turns before one.
static inline int samples_before(__local const int2 *windows, int turn) {
    int count = 0;
    for (int before = 0; before < turn; before++) count += windows[before].y;
    return count;
}

// The cells of a plane between which the light of columns r to r + 3 may fall.
static inline Span span_of_four(__global const float8 *restrict edges, int r, int n_r, float2 direction, int n_x, int n_y) {
    const int first = min(r, n_r - 1), final = min(r + 3, n_r - 1);
    Span span = span_of((float8)(edges[first].lo, edges[final].hi), (float4)(direction, 0.0f, 0.0f), n_x, n_y);
    for (int column = first; column <= final; column++) span.slack = fmax(span.slack, edges[column].s3);
    return span;
}

// Greatest number of cells of a plane.
static inline int most_cells(const Span *span) {
    const float gap = span->to.x - span->from.x, change = span->to.y - span->from.y;
    return (int)fmin(fmax(fabs(gap), fabs(gap + (span->planes - 1) * change)) + 2.0f * span->slack, 1e6f) + 1;
}
