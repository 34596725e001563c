#include "partial.h"

#define OUT __global float *
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
