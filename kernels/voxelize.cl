#include "common.h"

#define SAMPLES 16
#define GENERATOR 7
#define OFFSET 11
#define RAY_SHIFT 22

// Like FIELD_KERNEL, for a kernel without fields.
#define COUNT_KERNEL __kernel __attribute__((vec_type_hint(float16))) void

// One edge of a triangle: at (x, y), offset + along_x * x + along_y * y is twice the area between edge and point; the
// point is inside if that is at least own for all three edges.
typedef struct {
    long along_x, along_y, offset;
    int own;
} Edge;

static inline Edge edge(int ax, int ay, int bx, int by) {
    const long dx = bx - ax, dy = by - ay;
    return (Edge){-dy, dx, dy * ax - dx * ay, dy < 0 || (dy == 0 && dx > 0) ? 0 : 1};
}

static inline long at(const Edge e, long x, long y) { return e.offset + e.along_x * x + e.along_y * y; }

// The edge function's largest value in the square of one column.
static inline long most(const Edge e, long corner, int bits) {
    return corner + ((max(e.along_x, 0L) + max(e.along_y, 0L)) << bits);
}

// Where the plane of the triangle is met, rounded to a unit; areas of 2^40 times heights of 2^20 fit 64 bits.
static inline int height(long wa, long wb, long wc, int az, int bz, int cz) {
    const int base = min(az, min(bz, cz));
    const long area = wa + wb + wc;
    const ulong sum = (ulong)(wa * (az - base) + wb * (bz - base) + wc * (cz - base) + area / 2);
    return base + (int)(sum / (ulong)area);
}

// Position of a ray within its column.
static inline long ray_x(int ray, int bits) { return ((2 * ray + 1) << bits) / (2 * SAMPLES); }
static inline long ray_y(int ray, int bits) {
    return ((2 * ((GENERATOR * ray + OFFSET) % SAMPLES) + 1) << bits) / (2 * SAMPLES);
}

// Which rays of a column meet the triangle, one bit each; ea, eb and ec are its edges at the column's corner.
static inline uint met_rays(const Edge a, const Edge b, const Edge c, long ea, long eb, long ec, int bits) {
    uint rays = 0;
    for (int i = 0; i < SAMPLES; i++) {
        const long px = ray_x(i, bits), py = ray_y(i, bits);
        const long wa = ea + a.along_x * px + a.along_y * py - a.own;
        const long wb = eb + b.along_x * px + b.along_y * py - b.own;
        const long wc = ec + c.along_x * px + c.along_y * py - c.own;
        rays |= (uint)((wa | wb | wc) >= 0) << i;
    }
    return rays;
}

// Counts the crossings of the columns' rays with a triangle in tally, or, if lists are given, adds them to the lists
// that begin where tally states: ray, height within the grid, whether the ray leaves.
static inline void cross_triangle(__global const int *t, int2 low, int2 high, int bits, int top, __global int *tally,
                                  __global int *lists, int n_y) {
    const Edge a = edge(t[3], t[4], t[6], t[7]), b = edge(t[6], t[7], t[0], t[1]), c = edge(t[0], t[1], t[3], t[4]);
    const int x_begin = max(low.x, min(t[0], min(t[3], t[6])) >> bits);
    const int x_end = min(high.x, (max(t[0], max(t[3], t[6])) >> bits) + 1);
    const int y_begin = max(low.y, min(t[1], min(t[4], t[7])) >> bits);
    const int y_end = min(high.y, (max(t[1], max(t[4], t[7])) >> bits) + 1);
    for (int x = x_begin; x < x_end; x++)
        for (int y = y_begin; y < y_end; y++) {
            const long x0 = (long)x << bits, y0 = (long)y << bits;
            const long ea = at(a, x0, y0), eb = at(b, x0, y0), ec = at(c, x0, y0);
            if (most(a, ea, bits) < 0 || most(b, eb, bits) < 0 || most(c, ec, bits) < 0) continue;
            uint rays = met_rays(a, b, c, ea, eb, ec, bits);
            if (!lists) tally[(size_t)x * n_y + y] += popcount(rays);
            if (!lists || !rays) continue;
            __global int *list = lists + tally[(size_t)x * n_y + y];
            for (; rays; rays &= rays - 1) {
                const int ray = popcount((rays & -rays) - 1);
                const long px = ray_x(ray, bits), py = ray_y(ray, bits);
                const int h = height(ea + a.along_x * px + a.along_y * py, eb + b.along_x * px + b.along_y * py,
                                     ec + c.along_x * px + c.along_y * py, t[2], t[5], t[8]);
                list[++list[0]] = ray << RAY_SHIFT | clamp(h, 0, top) << 1 | (t[9] > 0);
            }
        }
}

// An item owns a square of columns, all of z.
COUNT_KERNEL count_crossings(__global const int *restrict triangles, __global const int *restrict members,
                             __global const int *restrict first, __global const int *restrict last, int tile, int bits,
                             __global int *restrict counts, int n_triangle, int n_member, int n_tile_x, int n_tile_y,
                             int n_x, int n_y) {
    const int item = get_global_id(1) * n_tile_y + get_global_id(0);
    const int2 low = (int2)(get_global_id(1), get_global_id(0)) * tile, high = min(low + tile, (int2)(n_x, n_y));
    for (int x = low.x; x < high.x; x++)
        for (int y = low.y; y < high.y; y++) counts[(size_t)x * n_y + y] = 0;
    for (int m = first[item]; m < last[item]; m++)
        cross_triangle(triangles + 10 * members[m], low, high, bits, 0, counts, 0, n_y);
}

#ifdef COMPILE_voxelize
#define PLACE(x, y, z) slice_offset(x, y, z, n_x, n_y, LANES)

// From height h on, all voxels of a column change by weight; the voxel that h cuts changes by its part above h.
static inline void change(__global float *volume, int x, int y, int h, float weight, int bits,
                          int n_x, int n_y, int n_z) {
    const int z = max(h, 0) >> bits, below = max(h, 0) - (z << bits);
    if (z < n_z) volume[PLACE(x, y, z)] += weight * ((1 << bits) - below);
    if (below && z + 1 < n_z) volume[PLACE(x, y, z + 1)] += weight * below;
}

// Shell's sort of code[0..n): lists are short, and no other memory is needed.
static inline void sort(__global int *code, int n) {
    int gap = 1;
    while (gap < n / 3) gap = 3 * gap + 1;
    for (; gap > 0; gap /= 3)
        for (int i = gap; i < n; i++) {
            const int moved = code[i];
            int j = i;
            for (; j >= gap && code[j - gap] > moved; j -= gap) code[j] = code[j - gap];
            code[j] = moved;
        }
}

// Every ray of a column from below: it is inside from where its winding number rises above 0 to where it falls to 0
// again. Returns the lowest and the highest voxel with a change.
static inline int2 walk(__global const int *code, int n, int x, int y, int bits, __global float *volume, int n_x,
                        int n_y, int n_z) {
    const float weight = 1.0f / (SAMPLES << bits);
    int ray = -1, winding = 0;
    int2 reach = (int2)(n_z, 0);
    for (int k = 0; k < n; k++) {
        if (code[k] >> RAY_SHIFT != ray) {
            ray = code[k] >> RAY_SHIFT;
            winding = 0;
        }
        const int before = winding, h = (code[k] & ((1 << RAY_SHIFT) - 1)) >> 1;
        winding += code[k] & 1 ? -1 : 1;
        if ((before > 0) == (winding > 0)) continue;
        change(volume, x, y, h, winding > 0 ? weight : -weight, bits, n_x, n_y, n_z);
        reach = (int2)(min(reach.x, h >> bits), max(reach.y, (h >> bits) + 1));
    }
    return reach;
}

// Turns the changes along a column into fractions, and returns their sum.
static inline float settle(__global float *volume, int x, int y, int2 reach, int n_x, int n_y, int n_z) {
    float inside = 0.0f, sum = 0.0f;
    for (int z = reach.x; z < n_z && (z <= reach.y || inside > 0.0f); z++) {
        __global float *voxel = volume + PLACE(x, y, z);
        inside += *voxel;
        *voxel = inside;
        sum += inside;
    }
    return sum;
}

FIELD_KERNEL voxelize(__global const int *restrict triangles, __global const int *restrict members,
                      __global const int *restrict first, __global const int *restrict last,
                      __global int *restrict start, int tile, int bits, int row, __global int *restrict lists,
                      __global float *restrict volume, __global float *restrict filled,
                      int n_triangle, int n_member, int n_tile_x, int n_tile_y, int n_x, int n_y, int n_entry, int n_z) {
    const int item = get_global_id(1) * n_tile_y + get_global_id(0), begin = first[item], end = last[item];
    const int2 low = (int2)(row + get_global_id(1), get_global_id(0)) * tile, high = min(low + tile, (int2)(n_x, n_y));
    const int slabs = (n_z + LANES - 1) / LANES;
    for (int slab = 0; slab < slabs; slab++)
        for (int x = low.x; x < high.x; x++) {
            __global float *line = volume + PLACE(x, low.y, slab * LANES);
            for (int k = 0; k < (high.y - low.y) * LANES; k++) line[k] = 0.0f;
        }
    for (int x = low.x; x < high.x; x++)
        for (int y = low.y; y < high.y; y++) lists[start[(size_t)x * n_y + y]] = 0;
    for (int m = begin; m < end; m++)
        cross_triangle(triangles + 10 * members[m], low, high, bits, n_z << bits, start, lists, n_y);
    float sum = 0.0f;
    for (int x = low.x; x < high.x; x++)
        for (int y = low.y; y < high.y; y++) {
            __global int *list = lists + start[(size_t)x * n_y + y];
            if (list[0] == 0) continue;
            sort(list + 1, list[0]);
            const int2 reach = walk(list + 1, list[0], x, y, bits, volume, n_x, n_y, n_z);
            sum += settle(volume, x, y, reach, n_x, n_y, n_z);
        }
    filled[item] = sum;
}

#endif
