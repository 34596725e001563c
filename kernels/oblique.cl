#include "light.h"

// Column index, weight, row of slice 0 and rows per slice of the light at a voxel (x, y), relative to the axis.
static inline float4 look_up(__global const float4 *restrict light, int n_across, int n_along, float4 pose, float x,
                             float y) {
    const float across = fma(y, pose.x, fma(-x, pose.y, pose.z)) + 0.5f * (n_across - 1);
    const float along = fma(-x, pose.x, fma(-y, pose.y, pose.w)) + 0.5f * (n_along - 1);
    return sampled(light, n_across, n_along, across, along);
}

static inline float overlap(float distance, float reach, float inverse) {
    return clamp(reach - fabs(distance), 0.0f, 1.0f) * inverse;
}

// Height in rows of slices that are a given number of rows apart: whole multiples of that divide every row evenly.
static inline float even(float stretch) { return stretch * fmax(1.0f, floor(1.0f / stretch + 0.5f)); }

// Position of slice `z` among the rows; the same sum in both directions.
static inline float row_of(float4 ray, int z, float z0, float row0) { return fma(z - z0, ray.w, ray.z + row0); }

// Position of sample `index` of a column of the source: neighbors in z are in one slab, or in the next.
static inline size_t along_z(int index, size_t slab, int lanes) {
    const int which = index / lanes;
    return which * slab + (index - which * lanes);
}

#ifdef CPU
#define BUFFER 96
// Reads beyond the buffered samples return the zero on either side of them.
#define BUFFERED(index) clamp((index) - from + 1, 0, count + 1)

// Samples `from` .. `from + count` of a column of the source, into the nearest cache.
static inline void fetch(__global const float *restrict column, int from, int count, size_t slab, int lanes,
                         float *buffer) {
    int which = from / lanes, at = from - which * lanes;
    for (int k = 0; k < count; which++, at = 0) {
        const int run = min(count - k, lanes - at);
        for (int m = 0; m < run; m++) buffer[1 + k + m] = column[which * slab + at + m];
        k += run;
    }
    buffer[0] = buffer[count + 1] = 0.0f;
}
#endif

#ifdef COMPILE_back_oblique
FIELD_KERNEL back_oblique(__global const float *restrict sinogram, __global const float4 *restrict poses,
                          __global const float4 *restrict light, float width, float radius, int lanes,
                          __global float *restrict volume,
                          int n_angle, int n_r, int n_row, int n_across, int n_along, int n_x, int n_y, int n_z) {
    const float reach = 0.5f * (1.0f + width), inverse = 1.0f / width;
    const float x0 = 0.5f * (n_x - 1), y0 = 0.5f * (n_y - 1), z0 = 0.5f * (n_z - 1), row0 = 0.5f * (n_row - 1);
    const int taps = (int)ceil(2.0f * reach);
    const size_t slab = (size_t)n_angle * n_r * lanes;
    const int row = ITEM_MAJOR;
    if (row >= n_x) return;
    EACH_MINOR(j, n_y) {
        float sum[ITEM_LANES];
        for (int k = 0; k < ITEM_LANES; k++) sum[k] = 0.0f;
        const float x = row - x0, y = j - y0;
        if (within(x, y, radius)) for (int angle = 0; angle < n_angle; angle++) {
            const float4 ray = look_up(light, n_across, n_along, poses[angle], x, y);
            const float height = even(ray.w), reach_z = 0.5f * (1.0f + height), most = fmin(1.0f, height);
            const int first = (int)ceil(ray.x - reach), taps_z = (int)ceil(2.0f * reach_z);
            const int low = max((int)ceil(row_of(ray, ITEM_Z, z0, row0) - reach_z), 0);
            const int high = min((int)floor(row_of(ray, ITEM_Z + ITEM_LANES - 1, z0, row0) + reach_z), n_row - 1);
            for (int tap = max(first, 0); tap < min(first + taps, n_r); tap++) {
                const float weight = ray.y * overlap(ray.x - tap, reach, inverse) / even(ray.w);
                if (weight == 0.0f) continue;
                __global const float *column = sinogram + ((size_t)angle * n_r + tap) * lanes;
#ifdef CPU
                float buffer[BUFFER + 2];
                for (int from = low; from <= high; from += BUFFER) {
                    const int count = min(BUFFER, high - from + 1);
                    fetch(column, from, count, slab, lanes, buffer);
                    for (int t = 0; t < taps_z; t++) for (int k = 0; k < ITEM_LANES; k++) {
                        const float position = row_of(ray, ITEM_Z + k, z0, row0), place = ceil(position - reach_z) + t;
                        const float part = weight * clamp(reach_z - fabs(position - place), 0.0f, most);
                        sum[k] = fma(part, buffer[BUFFERED((int)place)], sum[k]);
                    }
                }
#else
                for (int t = 0; t < taps_z; t++) for (int k = 0; k < ITEM_LANES; k++) {
                    const float position = row_of(ray, ITEM_Z + k, z0, row0), place = ceil(position - reach_z) + t;
                    const float part = weight * clamp(reach_z - fabs(position - place), 0.0f, most);
                    if (place >= 0.0f && place < n_row) sum[k] = fma(part, column[along_z((int)place, slab, lanes)], sum[k]);
                }
#endif
            }
        }
        __global float *out = volume + slab_offset(n_x, n_y) + SAMPLE(row, j, n_y);
        for (int k = 0; k < ITEM_LANES; k++) out[k] = sum[k];
    }
}
#endif

#ifdef COMPILE_forward_oblique
FIELD_KERNEL forward_oblique(__global const float *restrict volume, __global const float4 *restrict poses,
                             __global const float4 *restrict light, __global const float8 *restrict edges,
                             float width, float radius, int lanes, __global float *restrict sinogram,
                             int n_x, int n_y, int n_slice, int n_angle, int n_across, int n_along, int n_r, int n_z) {
    const float reach = 0.5f * (1.0f + width), inverse = 1.0f / width;
    const float x0 = 0.5f * (n_x - 1), y0 = 0.5f * (n_y - 1), z0 = 0.5f * (n_slice - 1), row0 = 0.5f * (n_z - 1);
    const size_t slab = (size_t)n_x * n_y * lanes;
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    const float4 pose = poses[angle];
    EACH_MINOR(r, n_r) {
        float sum[ITEM_LANES];
        for (int k = 0; k < ITEM_LANES; k++) sum[k] = 0.0f;
        const Span span = span_of(edges[r], pose, n_x, n_y);
        for (int plane = 0; plane < span.planes; plane++) {
            const int2 cells = cells_of(&span, plane);
            for (int cell = cells.x; cell <= cells.y; cell++) {
                const int i = span.along_y ? cell : plane, j = span.along_y ? plane : cell;
                if (!within(i - x0, j - y0, radius)) continue;
                const float4 ray = look_up(light, n_across, n_along, pose, i - x0, j - y0);
                const float weight = ray.y * overlap(ray.x - r, reach, inverse) / even(ray.w);
                if (weight == 0.0f) continue;
                const float height = even(ray.w), reach_z = 0.5f * (1.0f + height), most = fmin(1.0f, height);
                const float slices = 1.0f / ray.w, lead = z0 - (ray.z + row0) * slices, span_z = reach_z * slices;
                const int taps_z = (int)ceil(2.0f * span_z) + 1;
                const int low = max((int)floor(fma(ITEM_Z - reach_z, slices, lead)), 0);
                const int high = min((int)ceil(fma(ITEM_Z + ITEM_LANES - 1 + reach_z, slices, lead)), n_slice - 1);
                __global const float *column = volume + ((size_t)i * n_y + j) * lanes;
#ifdef CPU
                float buffer[BUFFER + 2];
                for (int from = low; from <= high; from += BUFFER) {
                    const int count = min(BUFFER, high - from + 1);
                    fetch(column, from, count, slab, lanes, buffer);
                    for (int t = 0; t < taps_z; t++) for (int k = 0; k < ITEM_LANES; k++) {
                        const int z = (int)floor(fma(ITEM_Z + k - reach_z, slices, lead)) + t;
                        const float apart = row_of(ray, z, z0, row0) - (ITEM_Z + k);
                        const float part = weight * clamp(reach_z - fabs(apart), 0.0f, most);
                        sum[k] = fma(part, buffer[BUFFERED(z)], sum[k]);
                    }
                }
#else
                for (int t = 0; t < taps_z; t++) for (int k = 0; k < ITEM_LANES; k++) {
                    const int z = (int)floor(fma(ITEM_Z + k - reach_z, slices, lead)) + t;
                    const float apart = row_of(ray, z, z0, row0) - (ITEM_Z + k);
                    const float part = weight * clamp(reach_z - fabs(apart), 0.0f, most);
                    if (z >= 0 && z < n_slice) sum[k] = fma(part, column[along_z(z, slab, lanes)], sum[k]);
                }
#endif
            }
        }
        __global float *out = sinogram + slab_offset(n_angle, n_r) + SAMPLE(angle, r, n_r);
        for (int k = 0; k < ITEM_LANES; k++) out[k] = sum[k];
    }
}
#endif
