#include "partial.h"

#ifdef COMPILE_linear
FIELD_KERNEL linear(float a, ARRAY x, float b, ARRAY y, float floor, __global float *out, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT STORE(out + at, fmax((Vector)(floor), a * LOAD(x + at) + b * LOAD(y + at)));
}
#endif

#ifdef COMPILE_multiply
FIELD_KERNEL multiply(ARRAY x, ARRAY y, __global float *out, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT STORE(out + at, LOAD(x + at) * LOAD(y + at));
}
#endif

#ifdef COMPILE_apply_penalty
static inline Vector raised(Vector x, float power) {
    return power == 0.0f ? (Vector)(1.0f) : power == 1.0f ? x : power == 3.0f ? x * x * x : pow(x, (Vector)(power));
}

FIELD_KERNEL apply_penalty(ARRAY light, float weight, float power, int hold, float most, __global float *gradient,
                           __global float *restrict parts, SIZES, int n_part) {
    OWN_PART;
    SUMS(sum);
    EACH_VECTOR_AT {
        const Vector from = LOAD(light + at), lit = fmax(from, ZERO);
        Vector value = LOAD(gradient + at);
        if (weight != 0.0f) {
            const Vector root = raised(lit, power - 1.0f);
            value += weight * power * root;
            sum[v] += MASKED(REAL_LANES, root * lit);
        }
        if (hold) {
            value = select(value, fmin(value, ZERO), from <= ZERO);
            value = select(value, fmax(value, ZERO), from >= most);
        }
        STORE(gradient + at, value);
    }
    parts[part] = weight * sum_of(sum);
}
#endif

#ifdef COMPILE_fill_background
FIELD_KERNEL fill_background(ARRAY target, float low, float high, float reach, __global float *model, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const int near = disc_distance(i, j, n_i, n_j) <= reach * reach;
        STORE(model + at, near ? low + (high - low) * LOAD(target + at) : ZERO);
    }
}
#endif

#ifdef COMPILE_correct_by_ratio
FIELD_KERNEL correct_by_ratio(ARRAY dose, float scale, ARRAY target, float low, float high, float most,
                              __global float *model, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector wanted = low + (high - low) * LOAD(target + at);
        const Vector got = fmax(fmax(LOAD(dose + at) * scale, wanted / most), 1e-30f);
        STORE(model + at, LOAD(model + at) * fmin(wanted / got, (Vector)(most)));
    }
}
#endif

#ifdef COMPILE_correct_by_difference
FIELD_KERNEL correct_by_difference(ARRAY dose, float scale, ARRAY target, float low, float high, float gain_outside,
                                   float gain_inside, float reach, __global float *model, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        if (disc_distance(i, j, n_i, n_j) > reach * reach) continue;
        const Vector got = LOAD(dose + at) * scale;
        const Vector raise = gain_inside * fmax(ZERO, high - got), lower = gain_outside * fmax(ZERO, got - low);
        STORE(model + at, LOAD(model + at) + select(-lower, raise, LOAD(target + at) >= 0.5f));
    }
}
#endif
