#include "common.h"

__kernel void sum_bins(__global uint *restrict tally, __global const float *restrict factor,
                       __global const float *restrict basis, __global float *restrict whole,
                       __global float *restrict light, int n_column, int n_cell, int n_bin, int n_term) {
    const int column = get_global_id(1), first = get_global_id(0) * TILE_MINOR;
    if (column >= n_column) return;
    for (int cell = first; cell < min(first + TILE_MINOR, n_cell); cell++) {
        const size_t at = (size_t)column * n_cell + cell;
        __global uint2 *bins = (__global uint2 *)tally + at * n_bin;
        __global float *own = light + at * n_term;
        float sum = 0.0f;
        for (int term = 0; term < n_term; term++) own[term] = 0.0f;
        for (int bin = 0; bin < n_bin; bin++) {
            const uint2 pair = bins[bin];
            if (!(pair.x | pair.y)) continue;
            bins[bin] = (uint2)(0);
            const float value = fma(0x1p32f, convert_float(pair.y), convert_float(pair.x)) * factor[cell];
            sum += value;
            for (int term = 0; term < n_term; term++) own[term] = fma(basis[bin * n_term + term], value, own[term]);
        }
        whole[at] = sum;
    }
}
