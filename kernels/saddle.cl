#include "partial.h"

#ifdef COMPILE_light_step
FIELD_KERNEL light_step(ARRAY light, ARRAY columns, float step, float most, __global float *restrict ahead,
                        __global float *restrict after, __global float *restrict moved, SIZES, int n_part) {
    const int part = part_index(n_i, n_j, n_z);
    if (part < 0 || part >= n_part) return;
    Vector sum[VECTORS];
    EACH_VECTOR sum[v] = ZERO;
    EACH_VECTOR_AT {
        const Vector from = LOAD(light + at), weight = LOAD(columns + at);
        const Lanes lit = weight > ZERO;
        const Vector length = step / select((Vector)(1.0f), weight, lit);
        const Vector to = select(ZERO, fmin((Vector)(most), fmax(ZERO, from - length * LOAD(ahead + at))), lit);
        STORE(after + at, to);
        STORE(ahead + at, 2.0f * to - from);
        sum[v] += MASKED(REAL_LANES, weight * (to - from) * (to - from));
    }
    moved[part] = sum_of(sum);
}
#endif

#ifdef COMPILE_limit_step
FIELD_KERNEL limit_step(ARRAY ahead, ARRAY held, ARRAY target, ARRAY rows, float least, float leak, float loose,
                        float step, float reach, ARRAY wall, ARRAY cap, __global float *restrict wall_after,
                        __global float *restrict cap_after, __global float *restrict inside,
                        __global float *restrict outside, __global float *restrict moved,
                        __global float *restrict crossed, SIZES, int n_part) {
    const int part = part_index(n_i, n_j, n_z);
    if (part < 0 || part >= n_part) return;
    Vector in[VECTORS], out[VECTORS], far[VECTORS], product[VECTORS];
    EACH_VECTOR in[v] = out[v] = far[v] = product[v] = ZERO;
    const Vector one = (Vector)(1.0f);
    EACH_VECTOR_AT {
        const Lanes circle = (Lanes)(disc_distance(i, j, n_i, n_j) <= reach * reach ? -1 : 0);
        const Vector row = LOAD(rows + at), dose = LOAD(ahead + at), before = LOAD(wall + at), top = LOAD(cap + at);
        const Vector kind = LOAD(target + at), share = kind - 2.0f;
        const Lanes near = circle & (row > ZERO), body = kind >= 0.5f, gray = kind >= 1.5f;
        const Lanes tight = gray & (share < loose);
        const Vector weight = select(one, row, near);
        const Vector lower = select((Vector)(least), 0.5f * (1.0f - share + (2.0f - share) * least - leak), tight);
        const Vector upper = select(one, 0.5f * (1.0f + share + share * least + leak), tight);
        const Vector of_wall = weight + select(one, (Vector)(1.5f), gray);
        const Vector of_cap = weight + select(ZERO, (Vector)(1.5f), gray);
        const Vector excess = select(dose - leak, lower - dose, body);
        const Vector to = select(ZERO, fmax(ZERO, before + step * excess / of_wall), near);
        const Vector most = select(ZERO, fmax(ZERO, top + step * (dose - upper) / of_cap), near & body);
        STORE(wall_after + at, to);
        STORE(cap_after + at, most);
        const Vector higher = to - before, tighter = most - top;
        const Vector on_least = select(one, 1.0f - 0.5f * share, tight) * to - select(ZERO, 0.5f * share, tight) * most;
        const Vector on_leak = select(ZERO, 0.5f * (to + most), tight);
        in[v] += MASKED(REAL_LANES & body, on_least);
        out[v] += MASKED(REAL_LANES, select(to, on_leak, body));
        far[v] += MASKED(REAL_LANES, of_wall * higher * higher + of_cap * tighter * tighter);
        product[v] += MASKED(REAL_LANES, select(higher, tighter - higher, body) * 0.5f * (dose - LOAD(held + at)));
    }
    inside[part] = sum_of(in);
    outside[part] = sum_of(out);
    moved[part] = sum_of(far);
    crossed[part] = sum_of(product);
}
#endif

#ifdef COMPILE_price_dose
FIELD_KERNEL price_dose(ARRAY wall, ARRAY cap, ARRAY target, __global float *pull, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector price = LOAD(wall + at);
        STORE(pull + at, select(price, LOAD(cap + at) - price, LOAD(target + at) >= 0.5f));
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
