#include "partial.h"

#ifdef COMPILE_pick_voxels
__kernel void pick_voxels(ARRAY field, __global const int *restrict places, __global float *restrict picked, SIZES,
                          int n_pick) {
    const int k = get_global_id(0);
    if (k >= n_pick) return;
    picked[k] = field[slice_offset(places[3 * k], places[3 * k + 1], places[3 * k + 2], n_i, n_j, LANES)];
}
#endif

#ifdef COMPILE_interpolate
FIELD_KERNEL interpolate(ARRAY x, __global const float *restrict knots, __global const float *restrict values,
                         __global float *out, SIZES, int n_knot) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector place = LOAD(x + at);
        Vector found = (Vector)(values[0]);
        for (int k = 0; k + 1 < n_knot; k++) {
            const float length = knots[k + 1] - knots[k];
            found += clamp(place - knots[k], 0.0f, length) * ((values[k + 1] - values[k]) / length);
        }
        STORE(out + at, found);
    }
}
#endif

#ifdef COMPILE_conversion_deviation
FIELD_KERNEL conversion_deviation(ARRAY extinction, ARRAY sharp, ARRAY rounded, __global const float *restrict knots,
                                  __global const float *restrict slopes, float model, __global float *restrict variance,
                                  SIZES, int n_knot) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector place = LOAD(extinction + at), edge = LOAD(sharp + at) - LOAD(rounded + at);
        Vector slope = (Vector)(slopes[0]);
        for (int k = 1; k < n_knot; k++) slope = select(slope, (Vector)(slopes[k]), place >= knots[k]);
        STORE(variance + at, sqrt(LOAD(variance + at) * slope * slope + 4.0f * edge * edge + model * model));
    }
}
#endif
