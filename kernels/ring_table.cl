#define ROWS 8

#ifdef COMPILE_ring_pose
#include "light.h"
#ifdef cl_khr_fp64
typedef double Real;            // shares are small differences of integrals
#define DIVIDE(a, b) ((a) / (b))
#else
typedef float Real;
#endif
#include "footprint.h"

FIELD_KERNEL ring_pose(__global const float *restrict feet, int first, int columns, float factor, float fill, float sigma,
                       __global float *restrict pose, int n_angle, int n_cell, int n_foot, int n_z) {
    const int angle = ITEM_MAJOR, end = columns - ITEM_Z;
    if (angle >= n_angle) return;
    const float inverse_sigma = sigma > 0.0f ? 1.0f / sigma : 0.0f;
    pose += slab_offset(n_angle, n_cell);
    EACH_MINOR(cell, n_cell) {
        float light[ITEM_LANES];
        for (int lane = 0; lane < ITEM_LANES; lane++) light[lane] = 0.0f;
        for (int part = 0; part < n_foot; part++) {
            __global const float *given = feet + ((angle * n_cell + cell) * n_foot + part) * 5;
            if (given[2] == 0.0f) continue;
            const Foot foot = foot_of(given[3], given[4], 0.0f, given[2], fill, sigma);
            const Real u = given[0] - (first + ITEM_Z) + (Real)given[1];
            const int begin = max((int)ceil(u - foot.reach), 0), last = min((int)floor(u + foot.reach), min(ITEM_LANES, end) - 1);
            for (int lane = begin; lane <= last; lane++) {
                const Real apart = u - lane;
                const Real share = edge(&foot, apart + 0.5f * fill, sigma, inverse_sigma)
                                 - edge(&foot, apart - 0.5f * fill, sigma, inverse_sigma);
                light[lane] += faded(&foot, apart, sigma) * foot.gain * fmax(share, (Real)(0.0f));
            }
        }
        if (ITEM_Z == 0) light[0] *= factor;
        for (int v = 0; v < VECTORS; v++) STORE(pose + SAMPLE(angle, cell, n_cell), PASTE(vload, WIDTH)(v, light));
    }
}
#else
#include "partial.h"
#endif

#ifdef COMPILE_ring_entries
// Share of a wave that remains after a mean over an arc.
static inline float left_by(float arc, int wave) {
    const float x = 0.5f * arc * wave;
    return x == 0.0f ? 1.0f : sin(x) / x;
}

FIELD_KERNEL ring_entries(ARRAY spectrum, __global const int *restrict begins, __global const float *restrict arcs,
                          int columns, __global float *restrict entries, int n_k, int n_cell, int n_z, int n_sample, int n_entry) {
    const int k = ITEM_MAJOR, n = n_k * n_sample;
    if (2 * k > n_k) return;
    spectrum += slab_offset(n_k, n_cell);
    entries += (size_t)k * (n_entry / (n_k / 2 + 1));
    EACH_MINOR(cell, n_cell) {
        const int j = cell / ROWS, ring = cell % ROWS, wave = min(k + j * n_k, n - k - j * n_k);
        const int other_k = k ? n_k - k : 0, other_j = k ? n_sample - 1 - j : (n_sample - j) % n_sample;
        const float left = left_by(arcs[ring], wave) * left_by(arcs[ROWS + ring], wave) * 0.5f / n;
        __global const float *here = spectrum + SAMPLE(k, cell, n_cell);
        __global const float *there = spectrum + SAMPLE(other_k, other_j * ROWS + ring, n_cell);
        for (int lane = 0; lane < min(ITEM_LANES, min(columns, n_z) - ITEM_Z); lane += 2) {
            __global float *to = entries + begins[j] + (ITEM_Z + lane) * 2 * ROWS + ring;
            const float2 own = vload2(0, here + lane), other = vload2(0, there + lane);
            to[0] = left * (own.x + other.x);
            to[ROWS] = left * (own.y - other.y);
            to[2 * ROWS] = left * (own.y + other.y);
            to[3 * ROWS] = left * (other.x - own.x);
        }
    }
}
#endif

#ifdef COMPILE_ring_coefficients
#define EACH_RING UNROLL for (int i = 0; i < ROWS; i++)

__kernel void ring_coefficients(__global const int8 *restrict steps, __global const float *restrict pivots, int angles,
                                float own, float beside, __global float *restrict entries, __global float *restrict peaks,
                                int n_tile, int n_ring, int n_entry, int n_frequency, int n_block) {
    const int block = get_global_id(0), head = get_global_id(1), k = get_global_id(2);
    if (block >= n_block || head >= n_tile || k >= n_frequency || steps[head].s5 >= 0) return;
    entries += (size_t)k * (n_entry / n_frequency);
    peaks += (size_t)k * n_tile * n_block + block;
    const int kappa = k + steps[head].s4 * angles;
    pivots += kappa & 1;
    int last = head;
    for (int tile = head; tile >= 0; tile = steps[tile].s6) {
        last = tile;
        peaks[tile * n_block] = 0.0f;
    }
    for (int pair = block * ROWS; pair < (block + 1) * ROWS; pair++) {
        float2 next = (float2)(0.0f);                                   // real and imaginary part
        for (int tile = head; tile >= 0; tile = steps[tile].s6) {
            const int8 step = steps[tile];
            __global float *at = entries + step.s0 + pair * 2 * ROWS;
            if (pair < step.s1) EACH_RING {
                const int inner = step.s2 + i - 1;
                if (inner >= 0) next *= beside / pivots[2 * inner];
                next = (float2)(at[i], at[ROWS + i]) - next;
                at[i] = next.x;
                at[ROWS + i] = next.y;
            } else next = (float2)(0.0f);
        }
        next = (float2)(0.0f);
        for (int tile = last; tile >= 0; tile = steps[tile].s5) {
            const int8 step = steps[tile];
            __global float *at = entries + step.s0 + pair * 2 * ROWS;
            const float along = 1.0f / (own + 2.0f * beside * cospi(2.0f * kappa / (angles * step.s3)));
            float most = 0.0f;
            if (pair < step.s1) for (int i = ROWS - 1; i >= 0; i--) {
                next = ((float2)(at[i], at[ROWS + i]) - beside * next) / pivots[2 * (step.s2 + i)];
                at[i] = along * next.x;
                at[ROWS + i] = along * next.y;
                most = fmax(most, dot(next, next));
            } else next = (float2)(0.0f);
            peaks[tile * n_block] = fmax(peaks[tile * n_block], along * sqrt(most));
        }
    }
}
#endif
