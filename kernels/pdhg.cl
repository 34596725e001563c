#include "partial.h"

#ifdef COMPILE_primal_step
FIELD_KERNEL primal_step(ARRAY light, ARRAY columns, float step, __global float *restrict ahead,
                          __global float *restrict after, __global float *restrict moved, SIZES, int n_part) {
    OWN_PART;
    SUMS(sum);
    EACH_VECTOR_AT {
        const Vector from = LOAD(light + at), weight = LOAD(columns + at);
        const Lanes lit = weight > ZERO;
        const Vector length = step / select((Vector)(1.0f), weight, lit);
        const Vector to = select(ZERO, fmax(ZERO, from - length * LOAD(ahead + at)), lit);
        STORE(after + at, to);
        STORE(ahead + at, 2.0f * to - from);
        sum[v] += MASKED(REAL_LANES, weight * (to - from) * (to - from));
    }
    moved[part] = sum_of(sum);
}
#endif

#ifdef COMPILE_dual_step
FIELD_KERNEL dual_step(ARRAY ahead, ARRAY held, ARRAY target, ARRAY rows, float least, float leak, float step,
                       float reach, ARRAY lower, ARRAY upper, __global float *restrict lower_after,
                       __global float *restrict upper_after, __global float *restrict inside,
                       __global float *restrict outside, __global float *restrict moved,
                       __global float *restrict crossed, SIZES, int n_part) {
    OWN_PART;
    Vector in[VECTORS], out[VECTORS], far[VECTORS], product[VECTORS];
    EACH_VECTOR in[v] = out[v] = far[v] = product[v] = ZERO;
    const Vector one = (Vector)(1.0f);
    EACH_VECTOR_AT {
        const Lanes circle = (Lanes)(disc_distance(i, j, n_i, n_j) <= reach * reach ? -1 : 0);
        const Vector row = LOAD(rows + at), dose = LOAD(ahead + at), low = LOAD(lower + at), high = LOAD(upper + at);
        const Lanes near = circle & (row > ZERO), body = LOAD(target + at) >= 0.5f;
        const Vector weight = select(one, row, near);
        const Vector excess = select(dose - leak, least - dose, body);
        const Vector to = select(ZERO, fmax(ZERO, low + step * excess / (weight + 1.0f)), near);
        const Vector most = select(ZERO, fmax(ZERO, high + step * (dose - 1.0f) / weight), near & body);
        STORE(lower_after + at, to);
        STORE(upper_after + at, most);
        const Vector higher = to - low, tighter = most - high;
        in[v] += MASKED(REAL_LANES & body, to);
        out[v] += MASKED(REAL_LANES & ~body, to);
        far[v] += MASKED(REAL_LANES, (weight + 1.0f) * higher * higher + weight * tighter * tighter);
        product[v] += MASKED(REAL_LANES, select(higher, tighter - higher, body) * 0.5f * (dose - LOAD(held + at)));
    }
    inside[part] = sum_of(in);
    outside[part] = sum_of(out);
    moved[part] = sum_of(far);
    crossed[part] = sum_of(product);
}
#endif

#ifdef COMPILE_dual_dose
FIELD_KERNEL dual_dose(ARRAY lower, ARRAY upper, ARRAY target, __global float *pull, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector low = LOAD(lower + at);
        STORE(pull + at, select(low, LOAD(upper + at) - low, LOAD(target + at) >= 0.5f));
    }
}
#endif

#ifdef COMPILE_reflect
FIELD_KERNEL reflect(ARRAY step, ARRAY anchor, float share, __global float *now, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT STORE(now + at, share * (2.0f * LOAD(step + at) - LOAD(now + at)) +
                                       (1.0f - share) * LOAD(anchor + at));
}
#endif
