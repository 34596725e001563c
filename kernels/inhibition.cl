#include "partial.h"

#define OUT __global float *
#define MOST 40  // greatest number of steps of Newton's method

#if defined(COMPILE_inhibition_step) || defined(COMPILE_inhibition_adjoint)

// Decay of A while v arrives: see the definition.
static inline Vector depletion_substep(Vector a, Vector b, Vector v, float alpha, float floor) {
    Vector h = fmax(v / (a + b + floor), (v - a - b / alpha) / floor);
    for (int n = 0; n < MOST; n++) {
        const Vector left = exp(-h), kept = exp(-alpha * h);
        const Vector missing = v - a * (1.0f - left) - b * (1.0f - kept) / alpha - floor * h;
        const Vector step = missing / (a * left + b * kept + floor);
        h += step;
        if (!any(fabs(step) > 3e-7f * (0.05f + fabs(h)))) break;
    }
    return h;
}
#endif

#ifdef COMPILE_inhibition_step
FIELD_KERNEL inhibition_step(ARRAY visible, ARRAY ultraviolet, float visible_gain, float ultraviolet_gain,
                             float cross_gain, float alpha, float pairing, float floor, ARRAY a, ARRAY b, ARRAY c, ARRAY x,
                             OUT a_end, OUT b_end, OUT c_end, OUT x_end, SIZES) {
    if (part_index(n_i, n_j, n_z) < 0) return;
    EACH_VECTOR_AT {
        const Vector u = LOAD(ultraviolet + at), kept = exp(-0.5f * ultraviolet_gain * u), split = 1.0f - kept;
        const Vector lit = visible_gain * LOAD(visible + at) + cross_gain * u, before = LOAD(a + at), c0 = LOAD(c + at);
        const Vector b1 = LOAD(b + at) + 2.0f * c0 * split, b2 = b1 / (1.0f + pairing * b1);
        const Vector c2 = c0 * kept + 0.5f * (b1 - b2), h = depletion_substep(before, b2, lit, alpha, floor);
        const Vector b3 = b2 * exp(-alpha * h), b4 = b3 / (1.0f + pairing * b3), c4 = c2 + 0.5f * (b3 - b4);
        STORE(x_end + at, LOAD(x + at) + floor * h);
        STORE(a_end + at, before * exp(-h));
        STORE(b_end + at, b4 + 2.0f * c4 * split);
        STORE(c_end + at, c4 * kept);
    }
}
#endif

#ifdef COMPILE_inhibition_adjoint
FIELD_KERNEL inhibition_adjoint(ARRAY visible, ARRAY ultraviolet, float visible_gain, float ultraviolet_gain,
                                float cross_gain, float alpha, float pairing, float floor, ARRAY a, ARRAY b, ARRAY c,
                                ARRAY x_slope, OUT a_slope, OUT b_slope, OUT c_slope, OUT visible_slope,
                                OUT ultraviolet_slope, SIZES) {
    if (part_index(n_i, n_j, n_z) < 0) return;
    EACH_VECTOR_AT {
        const Vector u = LOAD(ultraviolet + at), kept = exp(-0.5f * ultraviolet_gain * u), split = 1.0f - kept;
        const Vector lit = visible_gain * LOAD(visible + at) + cross_gain * u, a0 = LOAD(a + at), c0 = LOAD(c + at);
        const Vector b1 = LOAD(b + at) + 2.0f * c0 * split, d1 = 1.0f / (1.0f + pairing * b1), b2 = b1 * d1;
        const Vector c2 = c0 * kept + 0.5f * (b1 - b2), h = depletion_substep(a0, b2, lit, alpha, floor);
        const Vector left = exp(-h), rest = exp(-alpha * h), b3 = b2 * rest, d3 = 1.0f / (1.0f + pairing * b3);
        const Vector c4 = c2 + 0.5f * (b3 - b3 * d3);
        Vector la = LOAD(a_slope + at), lb = LOAD(b_slope + at), lc = LOAD(c_slope + at);
        Vector lu = 0.5f * kept * c4 * (2.0f * lb - lc);
        lc = lc * kept + 2.0f * lb * split;
        lb = lb * d3 * d3 + 0.5f * lc * (1.0f - d3 * d3);
        const Vector lv = (floor * LOAD(x_slope + at) - la * a0 * left - alpha * lb * b3) / (a0 * left + b3 + floor);
        la = la * left - lv * (1.0f - left);
        lb = lb * rest - lv * (1.0f - rest) / alpha;
        lb = lb * d1 * d1 + 0.5f * lc * (1.0f - d1 * d1);
        lu += 0.5f * kept * c0 * (2.0f * lb - lc);
        STORE(a_slope + at, la);
        STORE(b_slope + at, lb);
        STORE(c_slope + at, lc * kept + 2.0f * lb * split);
        STORE(visible_slope + at, LOAD(visible_slope + at) + visible_gain * lv);
        STORE(ultraviolet_slope + at, LOAD(ultraviolet_slope + at) + ultraviolet_gain * lu + cross_gain * lv);
    }
}
#endif

#if defined(COMPILE_take_poses) || defined(COMPILE_put_poses)
// Rows of a part and of the whole turn lie in slabs of different size.
#define EACH_ROW(n_i, n_j)                                                                                             \
    const size_t near = slab_offset(n_i, n_j), far = slab_offset(n_angle, n_r);                                        \
    EACH_SAMPLE EACH_VECTOR
#endif

#ifdef COMPILE_take_poses
FIELD_KERNEL take_poses(ARRAY light, int first, OUT part, int n_angle, int n_r, int n_z, int n_pose) {
    const int n_i = n_pose, n_j = n_r;
    if (part_index(n_i, n_j, n_z) < 0) return;
    EACH_ROW(n_i, n_j) STORE(part + near + SAMPLE(i, j, n_r), LOAD(light + far + SAMPLE(first + i, j, n_r)));
}
#endif

#ifdef COMPILE_put_poses
FIELD_KERNEL put_poses(ARRAY part, int first, OUT light, int n_pose, int n_r, int n_z, int n_angle) {
    const int n_i = n_pose, n_j = n_r;
    if (part_index(n_i, n_j, n_z) < 0) return;
    EACH_ROW(n_i, n_j) STORE(light + far + SAMPLE(first + i, j, n_r), LOAD(part + near + SAMPLE(i, j, n_r)));
}
#endif
