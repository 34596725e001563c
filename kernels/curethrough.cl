#include "slices.h"

#ifdef COMPILE_pack_slices
PACK_KERNEL pack_slices(__global const uchar *restrict levels, int threshold, int block, __global uint *restrict words,
                        __global int *restrict solid, int n_slice, int n_y, int n_x, int n_word, int n_strip) {
    STRIP
    words += (block % n_word) * plane + row;
    int count = 0;
    for (int x = x_begin; x < x_end; x += PACK) store_word(words, x, n_x, (Word)0);
    for (int n = 0; n < n_slice; n++) {
        __global const uchar *line = levels + n * plane + row;
        for (int x = x_begin; x < x_end; x += PACK) {
            const Whole level = TO_WHOLE(load_bytes(line, x, n_x));
            const Whole yes = (level >= threshold && NUMBERS + x < n_x) ? (Whole)1 : (Whole)0;
            if (!ANY(yes != 0)) continue;
            count += summed(yes);
            store_word(words, x, n_x, AS_WORD(AS_WHOLE(load_word(words, x, n_x)) | yes << n));
        }
    }
    solid[(size_t)y * n_strip + strip] = count;
}
#endif

#ifdef COMPILE_expose_slices
PACK_KERNEL expose_slices(__global const uchar *restrict levels, __global const float *restrict light, float decay,
                          float part, float fade, __global float *restrict state, __global float *restrict doses,
                          __global float *restrict peaks, int n_slice, int n_y, int n_x, int n_kept, int n_strip) {
    STRIP
    __global float *own = state + row, *rests = state + plane + row;
    Real peak = (Real)0.0f;
    int x = x_begin;
    for (; x + PACKS * PACK <= x_end; x += PACKS * PACK) {  // one cache line of levels at a time, doses in registers
        Real dose[PACKS], rest[PACKS];
        UNROLL for (int v = 0; v < PACKS; v++) {
            dose[v] = load_real(own, x + v * PACK, n_x);
            rest[v] = load_real(rests, x + v * PACK, n_x);
        }
        for (int n = n_slice - 1; n >= 0; n--) {
            __global const uchar *line = levels + n * plane + row;
            Real change[PACKS];
            light_of_packs(light, line, x, n_x, change);
            UNROLL for (int v = 0; v < PACKS; v++) change[v] -= decay * dose[v];
            if (n < n_kept)
                UNROLL for (int v = 0; v < PACKS; v++)
                    stream_real(doses + n * plane + row + x + v * PACK, (dose[v] + part * change[v]) * fade);
            UNROLL for (int v = 0; v < PACKS; v++) {
                add(&dose[v], &rest[v], change[v]);
                peak = fmax(peak, dose[v]);
            }
        }
        UNROLL for (int v = 0; v < PACKS; v++) {
            store_real(own, x + v * PACK, n_x, dose[v]);
            store_real(rests, x + v * PACK, n_x, rest[v]);
        }
    }
    for (; x < x_end; x += PACK) {
        Real dose = load_real(own, x, n_x), rest = load_real(rests, x, n_x);
        for (int n = n_slice - 1; n >= 0; n--) {
            const Real change = light_of(light, load_bytes(levels + n * plane + row, x, n_x)) - decay * dose;
            if (n < n_kept) store_real(doses + n * plane + row, x, n_x, (dose + part * change) * fade);
            add(&dose, &rest, change);
            peak = fmax(peak, NUMBERS + x < n_x ? dose : (Real)0.0f);
        }
        store_real(own, x, n_x, dose);
        store_real(rests, x, n_x, rest);
    }
    peaks[(size_t)y * n_strip + strip] = highest(peak);
}
#endif

#ifdef COMPILE_judge_slices
PACK_KERNEL judge_slices(__global const uchar *restrict levels, __global const uint *restrict words, int block,
                         __global const float *restrict light, float decay, float scale, int layered, float critical,
                         __global float *restrict state, __global float *restrict heights, __global float *restrict peaks,
                         int n_slice, int n_y, int n_x, int n_word, int n_strip) {
    STRIP
    words += (block % n_word) * plane + row;
    __global float *own = state + row, *rests = state + plane + row, *over = heights + row, *under = over + plane;
    Real peak = (Real)0.0f;
    for (int n = n_slice - 1; n >= 0; n--) {
        __global const uchar *line = levels + n * plane + row;
        for (int x = x_begin; x < x_end; x += PACK) {
            const Real before = load_real(own, x, n_x);
            Real dose = before, rest = load_real(rests, x, n_x);
            const Real shown = light_of(light, load_bytes(line, x, n_x));
            add(&dose, &rest, shown - decay * dose);
            store_real(own, x, n_x, dose);
            store_real(rests, x, n_x, rest);
            peak = fmax(peak, (NUMBERS + x < n_x) ? dose : (Real)0.0f);
            const Real start = layered ? dose : before, stop = layered ? (1.0f - decay) * dose : dose;
            const Whole was = start >= critical ? (Whole)1 : (Whole)0, is = stop >= critical ? (Whole)1 : (Whole)0;
            const Whole solid = AS_WHOLE(load_word(words, x, n_x) >> n) & 1;
            if (!ANY(was != solid || is != solid)) continue;
            Real share = (Real)1.0f;
            if (ANY(was != is)) {
                const Real limit = layered ? (Real)0.0f : shown / decay;
                const Real past = was != is ? (critical - limit) / (start - limit) : (Real)1.0f;
                share = was != is ? clamp(log(past) * scale, 0.0f, 1.0f) : (Real)1.0f;
            }
            const Real cured = was == 1 ? share : 1.0f - share;
            store_real(over, x, n_x, load_real(over, x, n_x) + (solid == 1 ? (Real)0.0f : cured));
            store_real(under, x, n_x, load_real(under, x, n_x) + (solid == 1 ? 1.0f - cured : (Real)0.0f));
        }
    }
    peaks[(size_t)y * n_strip + strip] = highest(peak);
}
#endif
