#include "partial.h"

#define FARTHEST 13
#define SIDE 27
#define CUBE (SIDE * SIDE * SIDE)
#define NO_CUT 1e9f
#define FULL 1e-4f
#define VOLUME __global const float *restrict

#ifdef cl_khr_fp64
typedef double Real;            // shares of a cube are small differences of its corners
#else
typedef float Real;
#endif

// Inward normal of the surface in a voxel; the outermost voxels repeat beyond the ends.
static inline float3 normal_at(__global const float *fraction, int x, int y, int z, int3 size, int lanes) {
    float3 gradient = (float3)(0.0f);
    size_t level[3];
    for (int k = 0; k < 3; k++) level[k] = slice_offset(0, 0, clamp(z + k - 1, 0, size.z - 1), size.x, size.y, lanes);
    for (int i = -1; i <= 1; i++)
        for (int j = -1; j <= 1; j++) {
            const int sample = clamp(x + i, 0, size.x - 1) * size.y + clamp(y + j, 0, size.y - 1);
            UNROLL for (int k = -1; k <= 1; k++) {
                const float weight = (k ? 2.0f : 4.0f) * (i ? 0.5f : 1.0f) * (j ? 0.5f : 1.0f);
                gradient += weight * fraction[level[k + 1] + (size_t)sample * lanes] * (float3)(i, j, k);
            }
        }
    const float length2 = dot(gradient, gradient);
    return length2 < 1e-12f ? (float3)(0.0f, 0.0f, 1.0f) : gradient / sqrt(length2);
}

#ifdef COMPILE_cut_voxels
// Depth of the center of a unit cube behind the plane that leaves `filled` of it, by Newton's method.
static inline float place_of(float3 normal, Real filled) {
    const Real a = fmax(fabs(normal.x), 1e-4f), b = fmax(fabs(normal.y), 1e-4f), c = fmax(fabs(normal.z), 1e-4f);
    const Real corners[8] = {0, a, b, c, a + b, a + c, b + c, a + b + c};
    const Real volume = 6 * a * b * c, half_way = (Real)0.5 * (a + b + c), less = fmin(filled, 1 - filled);
    Real cut = half_way;
    for (int step = 0; step < 7; step++) {
        Real share = 0, slope = 0;
        UNROLL for (int k = 0; k < 8; k++) {
            const Real beyond = fmax(cut - corners[k], (Real)0);
            const Real square = k == 0 || (k > 3 && k < 7) ? beyond * beyond : -beyond * beyond;
            slope += square;
            share += square * beyond;
        }
        cut = fmax(cut - (share / volume - less) / fmax(3 * slope / volume, (Real)1e-9), (Real)0);
    }
    return filled < (Real)0.5 ? cut - half_way : half_way - cut;
}

FIELD_KERNEL cut_voxels(VOLUME fraction, __global float *restrict place, __global float *restrict steps, int n_x,
                        int n_y, int n_z) {
    const int x = ITEM_MAJOR;
    const int3 size = (int3)(n_x, n_y, n_z);
    if (x >= n_x) return;
    const size_t slab = slab_offset(n_x, n_y);
    EACH_MINOR(y, n_y) {
        const size_t at = slab + SAMPLE(x, y, n_y);
        const size_t beside[4] = {x > 0 ? at - SAMPLE(1, 0, n_y) : at, x + 1 < n_x ? at + SAMPLE(1, 0, n_y) : at,
                                  y > 0 ? at - LANES : at, y + 1 < n_y ? at + LANES : at};
        float near[ITEM_LANES + 2], jump[ITEM_LANES];
        for (int k = 0; k < ITEM_LANES + 2; k++)
            near[k] = fraction[slice_offset(x, y, clamp(ITEM_Z + k - 1, 0, n_z - 1), n_x, n_y, LANES)];
        EACH_VECTOR {
            const Vector own = LOAD(fraction + at);
            Vector most = fmax(fabs(PASTE(vload, WIDTH)(0, near + v * WIDTH) - own),
                               fabs(PASTE(vload, WIDTH)(0, near + v * WIDTH + 2) - own));
            for (int side = 0; side < 4; side++) most = fmax(most, fabs(LOAD(fraction + beside[side]) - own));
            PASTE(vstore, WIDTH)(most, v, jump);
        }
        for (int lane = 0; lane < min(ITEM_LANES, n_z - ITEM_Z); lane++) {
            const float own = near[lane + 1];
            const bool cut = (own > FULL && own < 1.0f - FULL) || jump[lane] > 1.0f - 2.0f * FULL;
            steps[at + lane] = cut ? FARTHEST * (1 + SIDE + SIDE * SIDE) : NO_CUT;
            place[at + lane] = cut ? place_of(normal_at(fraction, x, y, ITEM_Z + lane, size, LANES), own) : NO_CUT;
        }
    }
}
#endif

#ifdef COMPILE_nearest_cut
FIELD_KERNEL nearest_cut(VOLUME steps, int axis, int span, __global float *restrict nearest, int n_x, int n_y, int n_z) {
    const int x = ITEM_MAJOR;
    if (x >= n_x) return;
    const size_t slab = slab_offset(n_x, n_y);
    EACH_MINOR(y, n_y) {
        const size_t at = slab + SAMPLE(x, y, n_y);
        if (axis < 2) {
            const int own = axis ? y : x, count = axis ? n_y : n_x, low = max(own - count + 1, -span), high = min(own, span);
            const long stride = axis ? LANES : (long)n_y * LANES;
            EACH_VECTOR {
                Vector best = (Vector)(NO_CUT);
                for (int k = low; k <= high; k++)
                    best = fmin(best, LOAD(steps + at - k * stride) + (float)(k * k * CUBE + k * (axis ? SIDE : 1)));
                STORE(nearest + at, best);
            }
        } else {
            float near[ITEM_LANES + 2 * FARTHEST];
            for (int k = FARTHEST - span; k < ITEM_LANES + FARTHEST + span; k++) {
                const int z = ITEM_Z + k - FARTHEST;
                near[k] = z >= 0 && z < n_z ? steps[slice_offset(x, y, z, n_x, n_y, LANES)] : NO_CUT;
            }
            EACH_VECTOR {
                Vector best = (Vector)(NO_CUT);
                for (int k = -span; k <= span; k++)
                    best = fmin(best, PASTE(vload, WIDTH)(0, near + FARTHEST + v * WIDTH - k)
                                          + (float)(k * k * CUBE + k * SIDE * SIDE));
                STORE(nearest + at, best);
            }
        }
    }
}
#endif

#ifdef COMPILE_signed_depths
FIELD_KERNEL signed_depths(VOLUME fraction, VOLUME place, VOLUME steps, int first, int lanes, float reach, float pitch,
                           __global float *restrict depth, int n_x, int n_y, int n_source, int n_z) {
    const int x = ITEM_MAJOR;
    const int3 size = (int3)(n_x, n_y, n_source);
    if (x >= n_x) return;
    const float limit = CUBE * floor((reach + 1.0f) * (reach + 1.0f) + 1.0f);    // no nearer surface lies beyond
    EACH_MINOR(y, n_y) for (int lane = 0; lane < min(ITEM_LANES, n_z - ITEM_Z); lane++) {
        const int z = first + ITEM_Z + lane;
        const size_t at = slice_offset(x, y, z, n_x, n_y, lanes);
        float found = reach;
        if (steps[at] < limit) {
            const int packed = (int)steps[at], i = packed % SIDE - FARTHEST, j = packed / SIDE % SIDE - FARTHEST;
            const int k = packed / (SIDE * SIDE) % SIDE - FARTHEST;
            const float3 step = (float3)(i, j, k), normal = normal_at(fraction, x - i, y - j, z - k, size, lanes);
            const float across = dot(step, normal), beside = sqrt(fmax(dot(step, step) - across * across, 0.0f));
            const float behind = across + place[slice_offset(x - i, y - j, z - k, n_x, n_y, lanes)];
            found = fmin(hypot(behind, fmax(beside - 0.6f, 0.0f)), reach);
        }
        depth[slab_offset(n_x, n_y) + SAMPLE(x, y, n_y) + lane] = pitch * (fraction[at] >= 0.5f ? found : -found);
    }
}
#endif

#ifdef COMPILE_tally_depths
FIELD_KERNEL tally_depths(VOLUME dose, VOLUME depth, __global const int *restrict ends, float width, float rounding,
                          __global float *restrict least, __global float *restrict greatest, __global uint *restrict counts,
                          int n_i, int n_j, int n_z, int n_part, int n_bin) {
    OWN_PART;
    const size_t slab = slab_offset(n_i, n_j);
    const int last = n_bin - 2, own = min(ITEM_LANES, n_z - ITEM_Z);
    least += (size_t)part * n_bin, greatest += (size_t)part * n_bin, counts += (size_t)part * n_bin;
    for (int bin = 0; bin < n_bin; bin++) least[bin] = INFINITY, greatest[bin] = -INFINITY, counts[bin] = 0;
    float deepest = INFINITY, farthest = -INFINITY, most = -INFINITY;     // beyond the last step, where most voxels are
    uint deep = 0;
    for (int i = I_BEGIN; i < I_END; i++)
        for (int j = max(ends[2 * i], 0); j < min(ends[2 * i + 1], n_j); j++)
            for (int k = 0; k < own; k++) {
                const size_t at = slab + SAMPLE(i, j, n_j) + k;
                const float value = dose[at], from = depth[at];
                if (!(from > -1e12f)) continue;
                most = value > most || !isfinite(value) ? value : most;
                const float place = fabs(from) / width + rounding;
                const bool inside = from >= 0.0f;
                if (place >= last) {
                    deepest = inside ? fmin(deepest, value) : deepest;
                    farthest = inside ? farthest : fmax(farthest, value);
                    deep += inside;
                } else if (inside) {
                    least[(int)place] = fmin(least[(int)place], value);
                    counts[(int)place]++;
                } else
                    greatest[(int)place] = fmax(greatest[(int)place], value);
            }
    least[last] = deepest, greatest[last] = farthest, counts[last] = deep;
    greatest[last + 1] = most == INFINITY ? NAN : most;
}
#endif
