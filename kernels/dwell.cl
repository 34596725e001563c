#include "common.h"

FIELD_KERNEL weigh_poses(__global const float *light, __global const float *restrict times, __global float *weighted,
                         int n_angle, int n_r, int n_z, int n_pose) {
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    const float time = times[angle % n_pose];
    const size_t slab = slab_offset(n_angle, n_r);
    EACH_MINOR(r, n_r) {
        const size_t at = slab + SAMPLE(angle, r, n_r);
        EACH_VECTOR STORE(weighted + at, time * LOAD(light + at));
    }
}
