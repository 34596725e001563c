#include "curve.h"

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

#ifdef COMPILE_tilted_gain
FIELD_KERNEL tilted_gain(__global const float *restrict up, __global const float *restrict aside, float level,
                         float along, float across, __global float *restrict gain, int n_z, int n_i, int n_j) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const float even = 1.0f + across * aside[i * n_j + j];
        for (int k = 0; k < WIDTH; k++)
            gain[at + v * WIDTH + k] = level * (even + along * up[min(ITEM_Z + v * WIDTH + k, n_z - 1)]);
    }
}
#endif

#ifdef COMPILE_match_dose
FIELD_KERNEL match_dose(ARRAY dose, ARRAY got, float least, float most, __global float *restrict gain, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector wanted = LOAD(dose + at), had = LOAD(got + at);
        const Lanes known = fmin(wanted, had) > least;
        const Vector share = clamp(wanted / select((Vector)(1.0f), had, known), 1.0f / most, most);
        STORE(gain + at, LOAD(gain + at) * select((Vector)(1.0f), share, known));
    }
}
#endif

#ifdef COMPILE_spare_voxels
FIELD_KERNEL spare_voxels(ARRAY dose, ARRAY target, ARRAY deviation, float share, float margin, float inside,
                          float greatest, __global float *restrict weight, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector sure = LOAD(dose + at) - (share * LOAD(deviation + at) + margin);
        const Lanes part = LOAD(target + at) >= 0.5f;
        const Lanes gone = (part & (sure > greatest)) | (~part & (sure >= inside));
        STORE(weight + at, select((Vector)(1.0f), ZERO, gone));
    }
}
#endif

#ifdef COMPILE_likelihood_weights
FIELD_KERNEL likelihood_weights(ARRAY dose, ARRAY seen, ARRAY deviation, __global const float *restrict judged,
                                __global const float *restrict samples, float start, float density,
                                __global float *restrict weight, __global float *restrict pull, SIZES,
                                int n_sample) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        Vector rise;
        const Vector had = LOAD(dose + at), spread = LOAD(deviation + at);
        const Vector made = look_up(had, samples, n_sample, start, density, &rise), slope = rise * density * had;
        const Lanes known = (spread > ZERO) & (Lanes)(judged[i * n_j + j] > 0.0f ? -1 : 0);
        const Vector over = select((Vector)(1.0f), spread, known), rate = MASKED(known, slope / (over * over));
        STORE(weight + at, MASKED(known, rate * slope));
        STORE(pull + at, MASKED(known, rate * (LOAD(seen + at) - made)));
    }
}
#endif

#ifdef COMPILE_share_gain
FIELD_KERNEL share_gain(ARRAY pull, ARRAY weight, float least, float shared, float strength,
                        __global float *restrict dose, __global float *restrict deviation, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector had = LOAD(dose + at), known = LOAD(weight + at);
        STORE(deviation + at, fabs(had) / sqrt(known / shared + strength));
        STORE(dose + at, had * (1.0f + LOAD(pull + at) / (known + least)));
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
