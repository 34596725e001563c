#include "common.h"

#define SAMPLES 16
#define GENERATOR 7

// One edge of a triangle: at (x, y), offset + along_x * x + along_y * y is twice the area between edge and point, and
// the point is inside where that reaches own for all three edges.
typedef struct {
    long along_x, along_y, offset;
    int own;
} Edge;

static inline Edge edge(int ax, int ay, int bx, int by) {
    const long dx = bx - ax, dy = by - ay;
    return (Edge){-dy, dx, dy * ax - dx * ay, dy < 0 || (dy == 0 && dx > 0) ? 0 : 1};
}

static inline long at(const Edge e, long x, long y) { return e.offset + e.along_x * x + e.along_y * y; }

// The edge's largest value in the square of one column.
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

static inline size_t place(int x, int y, int z, int n_x, int n_y) {
    return (((size_t)(z / LANES) * n_x + x) * n_y + y) * LANES + z % LANES;
}

// From height h on, all voxels of a column change by weight; the voxel that h cuts, by its part above h.
static inline void change(__global float *volume, int x, int y, int h, float weight, int bits,
                          int n_x, int n_y, int n_z) {
    const int z = max(h, 0) >> bits, below = max(h, 0) - (z << bits);
    if (z < n_z) volume[place(x, y, z, n_x, n_y)] += weight * ((1 << bits) - below);
    if (below && z + 1 < n_z) volume[place(x, y, z + 1, n_x, n_y)] += weight * below;
}

static inline void cross_triangle(__global const int *t, int2 low, int2 high, int bits, __global float *volume,
                                  int n_x, int n_y, int n_z) {
    const int unit = 1 << bits;
    const Edge a = edge(t[3], t[4], t[6], t[7]), b = edge(t[6], t[7], t[0], t[1]), c = edge(t[0], t[1], t[3], t[4]);
    const int az = t[2], bz = t[5], cz = t[8];
    if (min(az, min(bz, cz)) >= n_z << bits) return;
    const float weight = -t[9] / (float)(SAMPLES * unit);
    const int x_begin = max(low.x, min(t[0], min(t[3], t[6])) >> bits);
    const int x_end = min(high.x, (max(t[0], max(t[3], t[6])) >> bits) + 1);
    const int y_begin = max(low.y, min(t[1], min(t[4], t[7])) >> bits);
    const int y_end = min(high.y, (max(t[1], max(t[4], t[7])) >> bits) + 1);
    for (int x = x_begin; x < x_end; x++)
        for (int y = y_begin; y < y_end; y++) {
            const long x0 = (long)x << bits, y0 = (long)y << bits;
            const long ea = at(a, x0, y0), eb = at(b, x0, y0), ec = at(c, x0, y0);
            if (most(a, ea, bits) < 0 || most(b, eb, bits) < 0 || most(c, ec, bits) < 0) continue;
            for (int i = 0; i < SAMPLES; i++) {
                const long px = ((2 * i + 1) << bits) / (2 * SAMPLES);
                const long py = ((2 * (GENERATOR * i % SAMPLES) + 1) << bits) / (2 * SAMPLES);
                const long wa = ea + a.along_x * px + a.along_y * py;
                const long wb = eb + b.along_x * px + b.along_y * py;
                const long wc = ec + c.along_x * px + c.along_y * py;
                if (((wa - a.own) | (wb - b.own) | (wc - c.own)) >= 0)
                    change(volume, x, y, height(wa, wb, wc, az, bz, cz), weight, bits, n_x, n_y, n_z);
            }
        }
}

// Turns the changes along a column into fractions, and returns their sum.
static inline float settle(__global float *volume, int x, int y, int n_x, int n_y, int n_z) {
    float winding = 0.0f, sum = 0.0f;
    for (int z = 0; z < n_z; z++) {
        __global float *voxel = volume + place(x, y, z, n_x, n_y);
        winding += *voxel;
        *voxel = clamp(winding, 0.0f, 1.0f);
        sum += *voxel;
    }
    return sum;
}

// An item owns a square of columns, all of z.
FIELD_KERNEL voxelize(__global const int *restrict triangles, __global const int *restrict members,
                      __global const int *restrict first, __global const int *restrict last, int tile, int bits,
                      __global float *restrict volume, __global float *restrict filled,
                      int n_triangle, int n_member, int n_tile_x, int n_tile_y, int n_x, int n_y, int n_z) {
    const int item = get_global_id(1) * n_tile_y + get_global_id(0), begin = first[item], end = last[item];
    const int2 low = (int2)(get_global_id(1), get_global_id(0)) * tile, high = min(low + tile, (int2)(n_x, n_y));
    const int slabs = (n_z + LANES - 1) / LANES;
    for (int slab = 0; slab < slabs; slab++)
        for (int x = low.x; x < high.x; x++) {
            __global float *row = volume + place(x, low.y, slab * LANES, n_x, n_y);
            for (int k = 0; k < (high.y - low.y) * LANES; k++) row[k] = 0.0f;
        }
    for (int m = begin; m < end; m++)
        cross_triangle(triangles + 10 * members[m], low, high, bits, volume, n_x, n_y, n_z);
    float sum = 0.0f;
    if (begin < end)
        for (int x = low.x; x < high.x; x++)
            for (int y = low.y; y < high.y; y++) sum += settle(volume, x, y, n_x, n_y, n_z);
    filled[item] = sum;
}
