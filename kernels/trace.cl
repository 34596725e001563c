#include "medium.h"

#ifdef COMPILE_trace_entries
static inline int write_pair(__global float2 *pairs, int n_capacity, int count, int x, int y, int n_x, int n_y,
                             float weight) {
    if (!(weight > 0.0f) || x < 0 || y < 0 || x >= n_x || y >= n_y) return count;
    if (count < n_capacity) pairs[count] = (float2)(x * n_y + y, weight);
    return count + 1;
}

__kernel void trace_entries(__global const float4 *restrict medium, __global const float8 *restrict starts,
                            __global const float2 *restrict directions, float step, int most, int kind,
                            __global int *restrict counts, __global float2 *restrict entries, int n_p, int n_q,
                            int n_s, int n_ray, int n_angle, int n_capacity) {
    const size_t index = get_global_id(1) * n_ray + get_global_id(0);
    const Medium m = {medium, n_p, n_q, n_s};
    const int n_x = n_p - 2 * MARGIN, n_y = n_q - 2 * MARGIN;
    __global float2 *pairs = entries + index * n_capacity;
    Ray ray;
    bool on = enter(m, starts[get_global_id(0)], directions[get_global_id(1)], 1e6f, &ray);
    int count = 0, x = -9, y = -9;
    float4 held = (float4)(0.0f);               // weights of cells (x, y), (x, y + 1), (x + 1, y), (x + 1, y + 1)
    for (int k = 0; k < most && on; k++) {
        float3 middle;
        float weight;
        on = advance(m, &ray, 1e6f, step, kind, &middle, &weight);
        const int i = (int)floor(middle.x), j = (int)floor(middle.y);
        if (i != x || j != y) {                 // write the cells left behind, keep those still near
            float old[4] = {held.x, held.y, held.z, held.w}, kept[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            for (int corner = 0; corner < 4; corner++) {
                const int at_x = x + (corner >> 1), at_y = y + (corner & 1), dx = at_x - i, dy = at_y - j;
                if ((dx == 0 || dx == 1) && (dy == 0 || dy == 1)) kept[2 * dx + dy] = old[corner];
                else count = write_pair(pairs, n_capacity, count, at_x, at_y, n_x, n_y, old[corner]);
            }
            held = (float4)(kept[0], kept[1], kept[2], kept[3]);
            x = i;
            y = j;
        }
        const float a = middle.x - i, b = middle.y - j;
        held += weight * (float4)((1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b);
    }
    count = write_pair(pairs, n_capacity, count, x, y, n_x, n_y, held.x);
    count = write_pair(pairs, n_capacity, count, x, y + 1, n_x, n_y, held.y);
    count = write_pair(pairs, n_capacity, count, x + 1, y, n_x, n_y, held.z);
    count = write_pair(pairs, n_capacity, count, x + 1, y + 1, n_x, n_y, held.w);
    counts[index] = on ? -1 : count;
}
#endif

#ifdef COMPILE_survey_rays
__kernel void survey_rays(__global const float4 *restrict medium, __global const float8 *restrict starts,
                          __global const float2 *restrict directions, float top, float step, int most, int kind,
                          __global int *restrict steps, int n_p, int n_q, int n_s, int n_ray, int n_angle,
                          int n_pixel) {
    const Medium m = {medium, n_p, n_q, n_s};
    const int pixel = get_global_id(0), bundle = n_ray / n_pixel;
    int longest = 0;
    for (int b = 0; b < bundle; b++) {
        Ray ray;
        bool on = enter(m, starts[pixel * bundle + b], directions[get_global_id(1)], top, &ray);
        int k = 0;
        for (; k < most && on; k++) {
            float3 middle;
            float weight;
            on = advance(m, &ray, top, step, kind, &middle, &weight);
        }
        longest = on || longest < 0 ? -1 : max(longest, k);
    }
    steps[get_global_id(1) * n_pixel + pixel] = longest;
}
#endif
