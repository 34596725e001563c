#include "common.h"

// Column index and weight of the light at a voxel (x, y), relative to the axis, at one pose.
static inline float2 look_up(__global const float2 *restrict light, int n_across, int n_along, float2 direction,
                             float x, float y) {
    const float across = fma(y, direction.x, -x * direction.y) + 0.5f * (n_across - 1);
    const float along = fma(-x, direction.x, -y * direction.y) + 0.5f * (n_along - 1);
    const int i = clamp((int)across, 0, n_across - 2), j = clamp((int)along, 0, n_along - 2);
    const float a = across - i, b = along - j;
    __global const float2 *here = light + i * n_along + j;
    const float2 near = here[0] + b * (here[1] - here[0]);
    const float2 far = here[n_along] + b * (here[n_along + 1] - here[n_along]);
    return near + a * (far - near);
}

// Half-integers below 2048 square exactly in float32, so both directions agree on every voxel.
static inline bool within(float x, float y, float radius) { return x * x + y * y <= radius * radius; }

static inline float tent(float distance, float inverse_width) {
    return fmax(0.0f, 1.0f - fabs(distance) * inverse_width) * inverse_width;
}

#ifdef COMPILE_back_refracted
__kernel void back_refracted(__global const float *restrict sinogram, __global const float2 *restrict directions,
                             __global const float2 *restrict light, float width, float radius,
                             __global float *restrict volume,
                             int n_angle, int n_r, int n_z, int n_across, int n_along, int n_x, int n_y) {
    const int x_begin = ITEM_MAJOR * TILE_MAJOR, x_end = min(x_begin + TILE_MAJOR, n_x);
    const int y_begin = TILE_MINOR ? ITEM_MINOR * TILE_MINOR : 0, y_end = TILE_MINOR ? min(y_begin + TILE_MINOR, n_y) : n_y;
    const float inverse = 1.0f / width;
    const int taps = (int)ceil(2.0f * width);
    sinogram += slab_offset(n_angle, n_r);
    volume += slab_offset(n_x, n_y);
    for (int block = 0; block < n_angle; block += min(ANGLES, n_angle)) {
        const int stop = min(n_angle, block + min(ANGLES, n_angle));
        for (int row = x_begin; row < x_end; row++) for (int column = y_begin; column < y_end; column++) {
            const float x = row - 0.5f * (n_x - 1), y = column - 0.5f * (n_y - 1);
            __global float *out = volume + SAMPLE(row, column, n_y);
            Vector sum[VECTORS];
            EACH_VECTOR sum[v] = block ? LOAD(out) : (Vector)(0.0f);
            if (within(x, y, radius)) for (int angle = block; angle < stop; angle++) {
                const float2 ray = look_up(light, n_across, n_along, directions[angle], x, y);
                const int first = (int)ceil(ray.x - width);
                __global const float *pose = sinogram + SAMPLE(angle, 0, n_r);
                for (int tap = max(first, 0); tap < min(first + taps, n_r); tap++) {
                    const Vector weight = (Vector)(ray.y * tent(ray.x - tap, inverse));
                    __global const float *sample = pose + (size_t)tap * LANES;
                    EACH_VECTOR sum[v] = fma(weight, LOAD(sample), sum[v]);
                }
            }
            EACH_VECTOR STORE(out, sum[v]);
        }
    }
}
#endif

#ifdef COMPILE_forward_refracted
// Where a chord (p, cos d, sin d) turned to one pose crosses plane 0, and how far it drifts from plane to plane.
static inline float2 line(float4 chord, float2 direction, bool along_y, float planes_middle, float cells_middle) {
    const float c = direction.x * chord.y - direction.y * chord.z, s = direction.y * chord.y + direction.x * chord.z;
    const float p = chord.x;                // the chord is y c - x s = p
    const float slope = along_y ? c / s : s / c, start = along_y ? -p / s : p / c;
    return (float2)(start - planes_middle * slope + cells_middle, slope);
}

__kernel void forward_refracted(__global const float *restrict volume, __global const float2 *restrict directions,
                                __global const float2 *restrict light, __global const float8 *restrict edges,
                                float width, float radius, __global float *restrict sinogram,
                                int n_x, int n_y, int n_z, int n_angle, int n_across, int n_along, int n_r) {
    const int angle_begin = ITEM_MAJOR * TILE_MAJOR, angle_end = min(angle_begin + TILE_MAJOR, n_angle);
    const int r_begin = TILE_MINOR ? ITEM_MINOR * TILE_MINOR : 0, r_end = TILE_MINOR ? min(r_begin + TILE_MINOR, n_r) : n_r;
    const float inverse = 1.0f / width, x0 = 0.5f * (n_x - 1), y0 = 0.5f * (n_y - 1);
    const int longest = max(n_x, n_y);
    volume += slab_offset(n_x, n_y);
    sinogram += slab_offset(n_angle, n_r);
    for (int strip = 0; strip < longest; strip += min(STRIP, longest))
        for (int angle = angle_begin; angle < angle_end; angle++)
            for (int r = r_begin; r < r_end; r++) {
                const float2 direction = directions[angle];
                const float4 low = edges[r].lo, high = edges[r].hi;
                // the chord's own direction decides which planes it crosses most steeply
                const float cosine = direction.x * low.y - direction.y * low.z, sine = direction.y * low.y + direction.x * low.z;
                const bool along_y = fabs(sine) > fabs(cosine);
                const int planes = along_y ? n_y : n_x, cells = along_y ? n_x : n_y;
                const size_t row = (size_t)n_y * LANES, plane_stride = along_y ? LANES : row, cell_stride = along_y ? row : LANES;
                const float2 from = line(low, direction, along_y, along_y ? y0 : x0, along_y ? x0 : y0);
                const float2 to = line(high, direction, along_y, along_y ? y0 : x0, along_y ? x0 : y0);
                __global float *out = sinogram + SAMPLE(angle, r, n_r);
                Vector sum[VECTORS];
                EACH_VECTOR sum[v] = strip ? LOAD(out) : (Vector)(0.0f);
                for (int plane = strip; plane < min(strip + min(STRIP, longest), planes); plane++) {
                    const float a = from.x + plane * from.y, b = to.x + plane * to.y;
                    const int begin = max((int)ceil(fmin(a, b) - low.w), 0), end = min((int)floor(fmax(a, b) + low.w), cells - 1);
                    for (int cell = begin; cell <= end; cell++) {
                        const float x = (along_y ? cell : plane) - x0, y = (along_y ? plane : cell) - y0;
                        if (!within(x, y, radius)) continue;
                        const float2 ray = look_up(light, n_across, n_along, direction, x, y);
                        const Vector weight = (Vector)(ray.y * tent(ray.x - r, inverse));
                        __global const float *sample = volume + plane * plane_stride + cell * cell_stride;
                        EACH_VECTOR sum[v] = fma(weight, LOAD(sample), sum[v]);
                    }
                }
                EACH_VECTOR STORE(out, sum[v]);
            }
}
#endif
