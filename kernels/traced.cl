#include "medium.h"

#if defined(COMPILE_forward_traced) || defined(COMPILE_back_traced)
#define VOXEL(x, y, z) slice_offset(x, y, z, n_x, n_y, LANES)

// Whether a voxel can get light: none inside an insert can.
static inline bool takes(const Medium m, int x, int y, int z, int kind) {
    return !(kind & BLOCKS) || at_node(m, x + MARGIN, y + MARGIN, m.n_s > 1 ? z + MARGIN : 0).w > -DARK;
}

static inline size_t pixel_offset(int angle, int pixel, int n_angle, int n_r, int n_row, int lanes) {
    return slice_offset(angle, pixel / n_row, pixel % n_row, n_angle, n_r, lanes);
}

#define EACH_CORNER(middle)                                                                                      \
    const int x0 = (int)floor(middle.x), y0 = (int)floor(middle.y), z0 = (int)floor(middle.z);                   \
    const float fx = middle.x - x0, fy = middle.y - y0, fz = middle.z - z0;                                      \
    for (int corner = 0; corner < 8; corner++)

#define CORNER                                                                                                   \
    const int x = x0 + (corner >> 2), y = y0 + ((corner >> 1) & 1), z = z0 + (corner & 1);                       \
    if (x < 0 || y < 0 || z < 0 || x >= n_x || y >= n_y || z >= n_z || !takes(m, x, y, z, kind)) continue;       \
    const float share = (corner >> 2 ? fx : 1 - fx) * ((corner >> 1) & 1 ? fy : 1 - fy) * (corner & 1 ? fz : 1 - fz);
#endif

#ifdef COMPILE_forward_traced
__kernel void forward_traced(__global const float *restrict volume, __global const float4 *restrict medium,
                             __global const float8 *restrict starts, __global const float2 *restrict directions,
                             __global const int *restrict steps, float step, int kind, int lanes,
                             __global float *restrict sinogram, int n_x, int n_y, int n_z, int n_p, int n_q, int n_s,
                             int n_ray, int n_angle, int n_pixel, int n_r, int n_row) {
    const Medium m = {medium, n_p, n_q, n_s};
    const int pixel = get_global_id(0), angle = get_global_id(1), bundle = n_ray / n_pixel;
    const int most = steps[(size_t)angle * n_pixel + pixel];
    const float top = n_z + 1.0f;
    float sum = 0.0f;
    for (int b = 0; b < bundle; b++) {
        Ray ray;
        bool on = enter(m, starts[pixel * bundle + b], directions[angle], top, &ray);
        for (int k = 0; k < most && on; k++) {
            float3 middle;
            float weight, met = 0.0f;
            on = advance(m, &ray, top, step, kind, &middle, &weight);
            EACH_CORNER(middle) {
                CORNER
                met += share * volume[VOXEL(x, y, z)];
            }
            sum += weight * met;
        }
    }
    sinogram[pixel_offset(angle, pixel, n_angle, n_r, n_row, lanes)] = sum;
}
#endif

#ifdef COMPILE_back_traced
// Rays cross, and voxels therefore have no owner: the addition is atomic.
static inline void add(volatile __global float *where, float value) {
    int expected = as_int(*where), found;
    while ((found = atomic_cmpxchg((volatile __global int *)where, expected, as_int(as_float(expected) + value))) !=
           expected)
        expected = found;
}

__kernel void back_traced(__global const float *restrict sinogram, __global const float4 *restrict medium,
                          __global const float8 *restrict starts, __global const float2 *restrict directions,
                          __global const int *restrict steps, float step, int kind, int lanes,
                          __global float *volume, int n_angle, int n_r, int n_row, int n_p, int n_q, int n_s,
                          int n_ray, int n_pixel, int n_x, int n_y, int n_z) {
    const Medium m = {medium, n_p, n_q, n_s};
    const int pixel = get_global_id(0), angle = get_global_id(1), bundle = n_ray / n_pixel;
    const int most = steps[(size_t)angle * n_pixel + pixel];
    const float top = n_z + 1.0f, light = sinogram[pixel_offset(angle, pixel, n_angle, n_r, n_row, lanes)];
    for (int b = 0; b < bundle; b++) {
        Ray ray;
        bool on = enter(m, starts[pixel * bundle + b], directions[angle], top, &ray);
        for (int k = 0; k < most && on; k++) {
            float3 middle;
            float weight;
            on = advance(m, &ray, top, step, kind, &middle, &weight);
            EACH_CORNER(middle) {
                CORNER
                if (share * weight > 0.0f) add(volume + VOXEL(x, y, z), share * weight * light);
            }
        }
    }
}
#endif

