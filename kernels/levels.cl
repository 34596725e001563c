#include "slices.h"

#define BITS 32
#define BEYOND (1 << 20)
#define NEVER 1e30f
#define START_X 0.7548776662466927f
#define START_Y 0.5698402909980532f

typedef struct { Whole to_void, to_solid; } Ahead;

// Number of slices before the block that equal its first slice, if that is void or solid.
static inline Ahead look_ahead(__global const uint *words, int block, int platform, size_t row, size_t plane, int x,
                               int n_x, int n_word) {
    if (block == 0) return (Ahead){(Whole)BEYOND, (Whole)(platform ? BEYOND : 0)};
    Whole run = (Whole)0, open = (Whole)~0;
    Word last = (Word)0;
    int j = block - 1;
    for (; j >= 0 && j > block - n_word && ANY(open); j--) {
        const Word word = load_word(words + (j % n_word) * plane + row, x, n_x);
        if (j == block - 1) last = word >> (BITS - 1);
        const Word other = last != 0 ? ~word : word;
        run += open & AS_WHOLE(clz(other));
        open &= other == 0 ? (Whole)~0 : (Whole)0;
    }
    const Whole beyond = (AS_WHOLE(last) == 1 && (Whole)(j < 0 && !platform) != 0) ? (Whole)0 : (Whole)BEYOND;
    run += open & beyond;
    const Whole solid = AS_WHOLE(last) == 1 ? (Whole)~0 : (Whole)0;
    return (Ahead){run & ~solid, run & solid};
}

// An entry of a table for each pixel; neighbors mostly need the same one.
static inline Real looked_up(__global const float *table, Whole at) {
    if (ALL(at == LANE0(at))) return (Real)table[LANE0(at)];
    return GATHER(Real, table, at);
}

// The level whose light is nearest to the required light, and that light; in a void before a back side, not below it.
static inline Whole choose(Real wanted, __global const float *light, __global const float *edges,
                           __global const uchar *first, float bins, int n_bin, float spread, Real shift, Whole solid,
                           Whole run, Real *shown) {
    const float low = light[0], full = light[255];
    // a decaying dose stays a rounding error above level 0: no search is needed
    const float least = spread > 0.0f ? low : edges[0], most = spread > 0.0f ? full : edges[254];
    Whole level = wanted >= most ? (Whole)255 : (Whole)0;
    *shown = wanted >= most ? (Real)full : (Real)low;
    const Whole leads = (solid == 0 && run > 0 && wanted > low) ? (Whole)1 : (Whole)0;
    if (!ANY(wanted < most && (wanted > least || leads == 1))) return level;
    const Whole between = (wanted > low && wanted < full) ? (Whole)~0 : (Whole)0;
    const Real aim = between != 0 ? wanted + shift : wanted;
    const Whole bin = clamp(TO_WHOLE((clamp(aim, low, full) - low) * bins), (Whole)0, (Whole)(n_bin - 1));
    level = TO_WHOLE(GATHER(Bytes, first, bin));
    Whole more;
    do {
        more = (aim > GATHER(Real, edges, level) && level < 255) ? (Whole)1 : (Whole)0;
        level += more;
    } while (ANY(more != 0));
    *shown = GATHER(Real, light, level);
    const Whole up = (between != 0 && solid == 0 && run > 0 && *shown < wanted && level < 255) ? (Whole)1 : (Whole)0;
    if (ANY(up != 0)) {
        level += up;
        *shown = GATHER(Real, light, level);
    }
    return level;
}

PACK_KERNEL correct_slices(__global const uint *restrict words, int block, __global const float *restrict light,
                           __global const float *restrict edges, __global const uchar *restrict first, float bins,
                           float decay, __global const float *restrict inner, __global const float *restrict back,
                           int platform, float reached, float opened, float spread, __global float *restrict state,
                           __global int *restrict flaws, __global uchar *restrict levels, __global int *restrict missed,
                           int n_word, int n_y, int n_x, int n_bin, int n_below, int n_above, int n_void, int n_slice,
                           int n_strip) {
    STRIP
    __global const uint *here = words + (block % n_word) * plane + row;
    Whole lost = (Whole)0;
    // Slices are far apart in memory: values for one cache line are collected before they are written.
    Bytes own[BITS * PACKS];
    for (int x_line = x_begin; x_line < x_end; x_line += PACKS * PACK) {
        for (int v = 0; v < PACKS && x_line + v * PACK < x_end; v++) {
            const int x = x_line + v * PACK;
            Real dose = load_real(state + row, x, n_x), rest = load_real(state + plane + row, x, n_x);
            const Word word = load_word(here, x, n_x);
            const Ahead ahead = look_ahead(words, block, platform, row, plane, x, n_x, n_word);
            Real lowest = load_real(state + 2 * plane + row, x, n_x);
            Whole done = TO_WHOLE(load_real(state + 3 * plane + row, x, n_x)), low_count = (Whole)0, closed = (Whole)0;
            const Real lean = TO_REAL(NUMBERS + x) * START_X + y * START_Y;
            const Real shift = spread * (lean - floor(lean) - 0.5f);
            const int void_all = ALL(word == 0) && ALL(ahead.to_void >= n_void - 1);
            const int solid_all =
                ALL(word == ~0u) && ALL(ahead.to_solid >= n_above - 1) && ALL(done >= max(n_below - 1, 1));
            if (void_all || solid_all) {  // far from every edge
                const Real target = (Real)(void_all ? back[n_void - 1] : inner[n_below * n_above - 1]);
                for (int n = n_slice - 1; n >= 0; n--) {
                    Real shown;
                    const Whole level = choose(target - dose + decay * dose, light, edges, first, bins, n_bin, spread,
                                               shift, (Whole)solid_all, (Whole)BEYOND, &shown);
                    own[n * PACKS + v] = TO_BYTES(level);
                    const Real before = dose;
                    add(&dose, &rest, shown - decay * dose);
                    if (void_all) lowest = fmin(fmin(lowest, before), dose);
                }
                store_real(state + row, x, n_x, dose);
                store_real(state + plane + row, x, n_x, rest);
                if (void_all) store_real(state + 2 * plane + row, x, n_x, lowest);
                store_real(state + 3 * plane + row, x, n_x, void_all ? (Real)0.0f : TO_REAL(done + n_slice));
                continue;
            }
            for (int n = n_slice - 1; n >= 0; n--) {
                const Whole bit = AS_WHOLE(word >> n) & 1;
                const Whole solid = bit == 1 ? (Whole)~0 : (Whole)0;
                const Whole other = (AS_WHOLE(word) ^ solid) & (int)((1u << n) - 1u);
                const Whole carried = (ahead.to_solid & solid) | (ahead.to_void & ~solid);
                const Whole run = other != 0 ? n - BITS + AS_WHOLE(clz(other)) : n + carried;
                const Whole starts = (bit == 1 && done == 0) ? (Whole)1 : (Whole)0;
                if (ANY(starts != 0)) {
                    low_count += dose < reached ? starts : (Whole)0;
                    closed += lowest > opened ? starts : (Whole)0;
                }
                Real target;
                if (!ANY(bit == 1)) target = looked_up(back, min(run, n_void - 1));
                else {
                    const Whole place = min(done, n_below - 1) * n_above + min(run, n_above - 1);
                    const Real want = looked_up(inner, solid & place);
                    target = ALL(bit == 1) ? want : bit == 1 ? want : looked_up(back, ~solid & min(run, n_void - 1));
                }
                Real shown;
                const Whole level = choose(target - dose + decay * dose, light, edges, first, bins, n_bin, spread,
                                           shift, bit, run, &shown);
                own[n * PACKS + v] = TO_BYTES(level);
                const Real before = dose;
                add(&dose, &rest, shown - decay * dose);
                lowest = bit == 1 ? (Real)NEVER : fmin(fmin(lowest, before), dose);
                done = bit == 1 ? done + 1 : (Whole)0;
            }
            store_real(state + row, x, n_x, dose);
            store_real(state + plane + row, x, n_x, rest);
            store_real(state + 2 * plane + row, x, n_x, lowest);
            store_real(state + 3 * plane + row, x, n_x, TO_REAL(done));
            if (ANY(low_count != 0)) store_whole(flaws + row, x, n_x, load_whole(flaws + row, x, n_x) + low_count);
            if (ANY(closed != 0))
                store_whole(flaws + plane + row, x, n_x, load_whole(flaws + plane + row, x, n_x) + closed);
            lost += NUMBERS + x < n_x ? low_count : (Whole)0;
        }
        for (int n = 0; n < n_slice; n++)
            for (int v = 0; v < PACKS && x_line + v * PACK < x_end; v++)
                store_bytes(levels + n * plane + row, x_line + v * PACK, n_x, own[n * PACKS + v]);
    }
    missed[(size_t)y * n_strip + strip] = summed(lost);
}
