#include "partial.h"

// Dose at which limits are searched, and weight of a voxel.
#define DOSE (2.0f * LOAD(held + at) + LOAD(scaled_dual + at))
#define NEAR (disc_distance(i, j, n_i, n_j) <= reach * reach)
#define COUNTED (NEAR ? (Vector)(1.0f) : select((Vector)(rim), ZERO, INSIDE))
#define INSIDE (LOAD(target + at) >= 0.5f)

#ifdef COMPILE_find_levels
FIELD_KERNEL find_levels(ARRAY held, ARRAY scaled_dual, ARRAY target, float least, float leak, float reach, float rim,
                          __global float *restrict below, __global float *restrict shorts,
                          __global float *restrict above, __global float *restrict over, SIZES, int n_part) {
    OWN_PART;
    Vector few[VECTORS], lacking[VECTORS], many[VECTORS], leaking[VECTORS];
    EACH_VECTOR few[v] = lacking[v] = many[v] = leaking[v] = ZERO;
    EACH_VECTOR_AT {
        const Vector dose = DOSE, lacks = least - fmin((Vector)(1.0f), dose), leaks = dose - leak;
        const Lanes body = INSIDE, low = REAL_LANES & body & (lacks > ZERO), high = REAL_LANES & ~body & (leaks > ZERO);
        few[v] += MASKED(low, COUNTED);
        lacking[v] += MASKED(low, COUNTED * lacks);
        many[v] += MASKED(high, COUNTED);
        leaking[v] += MASKED(high, COUNTED * leaks);
    }
    below[part] = sum_of(few);
    shorts[part] = sum_of(lacking);
    above[part] = sum_of(many);
    over[part] = sum_of(leaking);
}
#endif

#ifdef COMPILE_clip_dose
FIELD_KERNEL clip_dose(ARRAY held, ARRAY target, float least, float leak, float relax, float reach, float rim,
                        __global float *scaled_dual, __global float *pull, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector dose = DOSE, own = LOAD(held + at);
        const Vector inside = fmax((Vector)(least), fmin((Vector)(1.0f), dose)), outside = fmin((Vector)(leak), dose);
        const Vector beyond = relax * select(outside, inside, INSIDE) + (1.0f - relax) * own;
        STORE(pull + at, COUNTED * (beyond - dose));
        STORE(scaled_dual + at, dose - own - beyond);
    }
}
#endif

#ifdef COMPILE_clip_light
FIELD_KERNEL clip_light(ARRAY light, ARRAY white, float push, float base, float relax,
                              __global float *scaled_dual, __global float *pull, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector own = LOAD(light + at), bright = 2.0f * own + LOAD(scaled_dual + at), most = LOAD(white + at);
        const Vector driven = bright + push * (bright - 0.5f * most);
        const Vector beyond = relax * fmin(most, fmax(ZERO, driven)) + (1.0f - relax) * own;
        STORE(pull + at, LOAD(pull + at) + base * (beyond - bright));
        STORE(scaled_dual + at, bright - own - beyond);
    }
}
#endif
