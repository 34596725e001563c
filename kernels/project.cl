#include "common.h"

// How the rays of one angle cross the planes of voxels that they meet most steeply; lengths in voxels.
typedef struct {
    int planes, cells;          // planes to cross, cells in each
    size_t plane_stride, cell_stride;
    float origin;               // cell position of ray 0 in plane 0
    float slope;                // shift of a ray per plane, in cells
    float step;                 // cells between neighboring rays
} Crossing;

static Crossing crossing(float2 direction, int n_x, int n_y, int n_r) {
    const float c = direction.x, s = direction.y;
    const float x0 = 0.5f * (n_x - 1), y0 = 0.5f * (n_y - 1), r0 = 0.5f * (n_r - 1);
    const size_t row = (size_t)n_y * LANES;
    if (fabs(c) >= fabs(s)) {   // planes of constant x: y = (r + x s) / c
        const float inverse = 1.0f / c;
        return (Crossing){n_x, n_y, row, LANES, y0 - (r0 + x0 * s) * inverse, s * inverse, inverse};
    }                           // planes of constant y: x = (y c - r) / s
    const float inverse = 1.0f / s;
    return (Crossing){n_y, n_x, LANES, row, x0 + (r0 - y0 * c) * inverse, c * inverse, -inverse};
}

#ifdef COMPILE_forward_joseph
// Planes of [first, last) in which RAYS neighboring rays all lie strictly between two cells: no bounds checks.
static int2 interior(const Crossing k, float origin, int first, int last) {
    const float low = origin + fmin(0.0f, (RAYS - 1) * k.step), high = origin + fmax(0.0f, (RAYS - 1) * k.step);
    if (fabs(k.slope) < 1e-6f)
        return low > 1.0f && high < k.cells - 2.0f ? (int2)(first, last) : (int2)(first, first);
    if (high - low >= k.cells - 3.0f) return (int2)(first, first);
    const float enter = (1.0f - low) / k.slope, leave = (k.cells - 2.0f - high) / k.slope;
    const int begin = clamp((int)ceil(clamp(fmin(enter, leave), -1e6f, 1e6f)) + 1, first, last);
    const int end = clamp((int)floor(clamp(fmax(enter, leave), -1e6f, 1e6f)) - 1, begin, last);
    return (int2)(begin, end);
}

static inline void cross_edge(__global const float *volume, const Crossing k, float origin, int plane, Vector *sum) {
    for (int ray = 0; ray < RAYS; ray++) {
        const float position = origin + plane * k.slope + ray * k.step, below = floor(position);
        if (!(below >= -1.0f && below <= k.cells - 1.0f)) continue;
        const int cell = (int)below;
        const float fraction = position - below;
        __global const float *near = volume + plane * k.plane_stride + (long)cell * (long)k.cell_stride;
        EACH_VECTOR {
            if (cell >= 0) sum[ray * VECTORS + v] += (1.0f - fraction) * LOAD(near);
            if (cell + 1 < k.cells) sum[ray * VECTORS + v] += fraction * LOAD(near + k.cell_stride);
        }
    }
}

// Adds to sum what RAYS neighboring rays meet in planes [first, last); origin is that of the first ray.
static inline void march(__global const float *restrict volume, const Crossing k, float origin, int first, int last,
                         Vector *sum) {
    const int2 inner = interior(k, origin, first, last);
    for (int plane = first; plane < inner.x; plane++) cross_edge(volume, k, origin, plane, sum);
    for (int plane = inner.x; plane < inner.y; plane++) {
        const float start = origin + plane * k.slope;
        __global const float *cells = volume + plane * k.plane_stride;
        UNROLL for (int ray = 0; ray < RAYS; ray++) {
            const float position = start + ray * k.step;
            const int cell = (int)position;
            const float fraction = position - (float)cell;
            __global const float *near = cells + (size_t)cell * k.cell_stride;
            EACH_VECTOR {
                const Vector partial = fma((Vector)(1.0f - fraction), LOAD(near), sum[ray * VECTORS + v]);
                sum[ray * VECTORS + v] = fma((Vector)(fraction), LOAD(near + k.cell_stride), partial);
            }
        }
    }
    for (int plane = inner.y; plane < last; plane++) cross_edge(volume, k, origin, plane, sum);
}

// A CPU core takes a block of angles and walks strips of planes that stay in its cache.
// A GPU thread takes TILE_MAJOR angles of one column and keeps their sums in registers while its group walks the strips.
FIELD_KERNEL forward_joseph(__global const float *restrict volume, __global const float2 *restrict directions,
                            float pitch, __global float *restrict sinogram,
                            int n_x, int n_y, int n_z, int n_angle, int n_r) {
    const int first_angle = ITEM_MAJOR * TILE_MAJOR, longest = max(n_x, n_y);
    volume += slab_offset(n_x, n_y);
    sinogram += slab_offset(n_angle, n_r);
#ifdef CPU
    const int last_angle = min(first_angle + TILE_MAJOR, n_angle);
    for (int strip = 0; strip < longest; strip += STRIP)
        for (int group = first_angle; group < last_angle; group += TOGETHER)
            for (int r = 0; r < n_r; r += RAYS)
                for (int angle = group; angle < min(group + TOGETHER, last_angle); angle++) {
                    const Crossing k = crossing(directions[angle], n_x, n_y, n_r);
                    const float length = pitch * fabs(k.step);
                    Vector sum[RAYS * VECTORS];
                    UNROLL for (int i = 0; i < RAYS * VECTORS; i++) sum[i] = (Vector)(0.0f);
                    march(volume, k, k.origin + r * k.step, min(strip, k.planes), min(strip + STRIP, k.planes), sum);
                    UNROLL for (int ray = 0; ray < RAYS; ray++) if (r + ray < n_r) {
                        __global float *out = sinogram + SAMPLE(angle, r + ray, n_r);
                        EACH_VECTOR {
                            const Vector part = sum[ray * VECTORS + v] * length;
                            STORE(out, strip ? LOAD(out) + part : part);
                        }
                    }
                }
#else
    const int r = ITEM_MINOR, v = 0;
    if (r >= n_r) return;
    Crossing k[TILE_MAJOR];
    Vector sum[TILE_MAJOR];
    UNROLL for (int a = 0; a < TILE_MAJOR; a++) {
        k[a] = crossing(directions[min(first_angle + a, n_angle - 1)], n_x, n_y, n_r);
        sum[a] = (Vector)(0.0f);
    }
    for (int strip = 0; strip < longest; strip += STRIP)
        UNROLL for (int a = 0; a < TILE_MAJOR; a++)
            march(volume, k[a], k[a].origin + r * k[a].step, min(strip, k[a].planes), min(strip + STRIP, k[a].planes),
                  sum + a);
    UNROLL for (int a = 0; a < TILE_MAJOR; a++)
        if (first_angle + a < n_angle)
            STORE(sinogram + SAMPLE(first_angle + a, r, n_r), sum[a] * (pitch * fabs(k[a].step)));
#endif
}
#endif

#ifdef COMPILE_back_joseph
// Adds to sum the light of ROWS x COLUMNS voxels from (x, y), relative to the axis, at one angle.
static inline void gather(__global const float *restrict pose, float2 direction, float x, float y, int n_r,
                          Vector *sum) {
    const float c = direction.x, s = direction.y, m = 1.0f / fmax(fabs(c), fabs(s));
    const float corner = y * c - x * s + 0.5f * (n_r - 1);
    const float low = corner + fmin(0.0f, -(ROWS - 1) * s) + fmin(0.0f, (COLUMNS - 1) * c);
    const float high = corner + fmax(0.0f, -(ROWS - 1) * s) + fmax(0.0f, (COLUMNS - 1) * c);
    const bool inside = low >= 0.01f && high < n_r - 1.01f;
    if (inside) {
        UNROLL for (int i = 0; i < ROWS; i++) UNROLL for (int j = 0; j < COLUMNS; j++) {
            const float u = corner - i * s + j * c;
            const int column = (int)u;
            const float beyond = u - (float)column;
            const float left = fmax(0.0f, m - m * m * beyond), right = fmax(0.0f, m - m * m * (1.0f - beyond));
            __global const float *near = pose + (size_t)column * LANES;
            EACH_VECTOR {
                Vector *total = sum + (i * COLUMNS + j) * VECTORS + v;
                *total = fma((Vector)(left), LOAD(near), *total);
                *total = fma((Vector)(right), LOAD(near + LANES), *total);
            }
        }
        return;
    }
    for (int i = 0; i < ROWS; i++) for (int j = 0; j < COLUMNS; j++) {
        const float u = corner - i * s + j * c, below = floor(u);
        if (!(below >= -1.0f && below <= n_r - 1.0f)) continue;
        const int column = (int)below;
        const float beyond = u - below;
        const float left = fmax(0.0f, m - m * m * beyond), right = fmax(0.0f, m - m * m * (1.0f - beyond));
        __global const float *near = pose + (long)column * LANES;
        EACH_VECTOR {
            Vector *total = sum + (i * COLUMNS + j) * VECTORS + v;
            if (column >= 0) *total += left * LOAD(near);
            if (column + 1 < n_r) *total += right * LOAD(near + LANES);
        }
    }
}

// An item owns TILE_MAJOR rows of x and processes them once for every ANGLES angles, whose data stay in its cache.
FIELD_KERNEL back_joseph(__global const float *restrict sinogram, __global const float2 *restrict directions,
                         float pitch, __global float *restrict volume,
                         int n_angle, int n_r, int n_z, int n_x, int n_y) {
    const int x_begin = ITEM_MAJOR * TILE_MAJOR, x_end = min(x_begin + TILE_MAJOR, n_x), y_end = MINOR_END(n_y);
    sinogram += slab_offset(n_angle, n_r);
    volume += slab_offset(n_x, n_y);
    for (int block = 0; block < n_angle; block += min(ANGLES, n_angle))
        for (int x = x_begin; x < x_end; x += ROWS)
            for (int y = MINOR_BEGIN; y < y_end; y += COLUMNS) {
                Vector sum[ROWS * COLUMNS * VECTORS];
                UNROLL for (int i = 0; i < ROWS * COLUMNS * VECTORS; i++) sum[i] = (Vector)(0.0f);
                const int stop = min(n_angle, block + min(ANGLES, n_angle));
                for (int angle = block; angle < stop; angle++)
                    gather(sinogram + SAMPLE(angle, 0, n_r), directions[angle], x - 0.5f * (n_x - 1),
                           y - 0.5f * (n_y - 1), n_r, sum);
                UNROLL for (int i = 0; i < ROWS; i++) UNROLL for (int j = 0; j < COLUMNS; j++)
                    if (x + i < x_end && y + j < y_end) {
                        __global float *out = volume + SAMPLE(x + i, y + j, n_y);
                        EACH_VECTOR {
                            const Vector part = sum[(i * COLUMNS + j) * VECTORS + v] * pitch;
                            STORE(out, block ? LOAD(out) + part : part);
                        }
                    }
            }
}
#endif
