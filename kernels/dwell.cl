#include "common.h"

#ifdef COMPILE_weigh_poses
FIELD_KERNEL weigh_poses(__global const float *light, __global const float *restrict times, __global float *weighted,
                         int n_angle, int n_r, int n_z, int n_pose) {
    const int angle = ITEM_MAJOR, begin = TILE_MINOR ? ITEM_MINOR * TILE_MINOR : 0;
    const int end = TILE_MINOR ? min(begin + TILE_MINOR, n_r) : n_r;
    if (angle >= n_angle) return;
    const float time = times[angle % n_pose];
    const size_t slab = slab_offset(n_angle, n_r);
    for (int r = begin; r < end; r++) {
        const size_t at = slab + SAMPLE(angle, r, n_r);
        EACH_VECTOR STORE(weighted + at, time * LOAD(light + at));
    }
}
#endif
