#include "common.h"

FIELD_KERNEL rebin_rays(__global const float *restrict parallel, __global const float *restrict rays,
                        __global float *restrict light, int n_angle, int n_column, int n_z, int n_r) {
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    __global const float *source = parallel + slab_offset(n_angle, n_column);
    __global float *out = light + slab_offset(n_angle, n_r);
    EACH_MINOR(r, n_r) {
        const float turn = rays[3 * r], column = rays[3 * r + 1], gain = rays[3 * r + 2];
        const int first = (int)floor(turn), near = (int)floor(column);
        Vector sum[VECTORS];
        EACH_VECTOR sum[v] = 0.0f;
        for (int k = 0; k < 4; k++) {
            const int a = ((angle + first + k / 2) % n_angle + n_angle) % n_angle, c = near + k % 2;
            if (c < 0 || c >= n_column) continue;
            const float weight = gain * (k / 2 ? turn - first : first + 1 - turn) * (k % 2 ? column - near : near + 1 - column);
            EACH_VECTOR sum[v] += weight * LOAD(source + SAMPLE(a, c, n_column));
        }
        EACH_VECTOR STORE(out + SAMPLE(angle, r, n_r), sum[v]);
    }
}
