#include "common.h"

// One lane after another: neighbors in z are in one slab, or in the next. Whole vectors if rows do not change and
// images are not cut into tiles; this takes a tenth of the time.
FIELD_KERNEL shift_images(__global const float *restrict source, __global const float4 *restrict moves,
                          __global const float *restrict tapers, int after, int lanes, __global float *restrict moved,
                          int n_image, int n_column, int n_row, int n_move, int n_tile, int n_taper,
                          int n_angle, int n_r, int n_z) {
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    const float4 own = moves[angle];
    if (own.z == 0.0f && own.w == 0.0f && n_move == n_angle && n_image == n_angle && n_tile == 1 && lanes == LANES && n_row == n_z
        && ITEM_Z + ITEM_LANES <= n_z) {
        source += slab_offset(n_angle, n_column);
        moved += slab_offset(n_angle, n_r);
        EACH_MINOR(r, n_r) {
            const int column = r + (int)own.x;
            const float near = column >= 0 && column < n_column ? 1.0f - own.y : 0.0f;
            const float far = column >= -1 && column < n_column - 1 ? own.y : 0.0f;
            __global const float *first = source + SAMPLE(angle, clamp(column, 0, n_column - 1), n_column);
            __global const float *second = source + SAMPLE(angle, clamp(column + 1, 0, n_column - 1), n_column);
            __global float *there = moved + SAMPLE(angle, r, n_r);
            EACH_VECTOR {
                const Vector weight = PASTE(vload, WIDTH)(v, tapers + ITEM_Z);
                STORE(there, weight * fma((Vector)(near), LOAD(first), far * LOAD(second)));
            }
        }
        return;
    }
    EACH_MINOR(r, n_r)
        for (int lane = 0; lane < ITEM_LANES; lane++) {
            const int z = ITEM_Z + lane;
            float sum = 0.0f;
            for (int k = angle; k < n_move && z < n_z; k += n_angle) {
                const float4 move = moves[k];
                __global const float *taper = tapers + (size_t)k * n_tile / n_move * n_taper;
                for (int corner = 0; corner < 4; corner++) {
                    const int column = r + (int)move.x + corner / 2, row = z + (int)move.z + corner % 2;
                    if (column < 0 || column >= n_column || row < 0 || row >= n_row) continue;
                    const float share = (corner / 2 ? move.y : 1.0f - move.y) * (corner % 2 ? move.w : 1.0f - move.w);
                    if (share == 0.0f) continue;
                    const size_t at = slice_offset(k % n_image, column, row, n_image, n_column, lanes);
                    sum = fma(share * taper[after ? z : row], source[at], sum);
                }
            }
            moved[slab_offset(n_angle, n_r) + SAMPLE(angle, r, n_r) + lane] = sum;
        }
}
