#include "partial.h"

#ifdef COMPILE_transport
#define SPECIES 3
#define AFTER_16(c, next) ((float16)(c.s12345678, c.s9abc, c.sde, c.sf, next))
#define BEFORE_16(c, last) ((float16)(last, c.s01234567, c.s89ab, c.scd, c.se))
#define AFTER_4(c, next) ((float4)(c.s123, next))
#define BEFORE_4(c, last) ((float4)(last, c.s012))
#define AFTER PASTE(AFTER_, WIDTH)
#define BEFORE PASTE(BEFORE_, WIDTH)
#define TINY 1e-30f

typedef struct {
    __global const float *spread, *walls, *rates;
    __global const uchar *open;
    int order, reacting, n_x, n_y, n_z;
    float optical, mechanical;
} Problem;

// One species along one row of y in one slab: its own samples, its neighbors in x, the slabs before and behind it.
typedef struct {
    __global const float *here, *low, *high, *before, *behind;
} Row;

typedef struct {
    __global const float *visible, *ultraviolet;
    __global float *dose, *optical_time, *mechanical_time;
} Light;

// What a species becomes by diffusion; passes holds 1 for the faces x low, x high, y low, y high that are open.
static inline Vector spread_one(const Problem p, Row row, int species, int x, int y, int slab, int base, float4 passes) {
    __global const float *D = p.spread + 3 * species, *wall = p.walls + 12 * species;
    __global const float *at = row.here + (long)y * LANES + base;
    const Vector here = *(__global const Vector *)at;
    const Vector x_low = x ? *(__global const Vector *)(row.low + (long)y * LANES + base) : wall[0] + wall[1] * here;
    const Vector x_high =
        x + 1 < p.n_x ? *(__global const Vector *)(row.high + (long)y * LANES + base) : wall[2] + wall[3] * here;
    const Vector y_low = y ? *(__global const Vector *)(at - LANES) : wall[4] + wall[5] * here;
    const Vector y_high = y + 1 < p.n_y ? *(__global const Vector *)(at + LANES) : wall[6] + wall[7] * here;
    const int z = slab * LANES + base, top = p.n_z - 1 - z;
    const float last = base ? at[-1] : slab ? row.before[(long)y * LANES + LANES - 1] : wall[8] + wall[9] * at[0];
    const Vector z_low = BEFORE(here, last);
    Vector z_high;
    if (top >= WIDTH) {
        const float next = base + WIDTH < LANES ? at[WIDTH] : row.behind[(long)y * LANES];
        z_high = AFTER(here, next);
    } else
        z_high = select(AFTER(here, 0.0f), wall[10] + wall[11] * here, LANE_IDS == (Lanes)(top));
    Vector out = fma((Vector)(D[0]), passes.x * (x_low - here) + passes.y * (x_high - here), here);
    out = fma((Vector)(D[1]), passes.z * (y_low - here) + passes.w * (y_high - here), out);
    return fma((Vector)(D[2]), (z_low - here) + (z_high - here), out);
}

static inline void mark(__global float *when, Vector before, Vector after, float level, float time, float step) {
    const Lanes now = (before < (Vector)(level)) & (after >= (Vector)(level));
    if (!any(now)) return;
    const Vector at = time + step * (level - before) / (after - before);
    *(__global Vector *)when = select(*(__global Vector *)when, at, now);
}

// Reactions of one step in place; adds to the dose only in a voxel the item owns.
static inline void react(const Problem p, Vector *a, Vector *b, Vector *c, Light light, size_t at, float time, bool own) {
    __global const float *k = p.rates;
    const Vector zero = (Vector)(0.0f);
    const Vector uv = *(__global const Vector *)(light.ultraviolet + at);
    const Vector power = *(__global const Vector *)(light.visible + at) + k[4] * uv;
    const Vector want_a = k[0] * power, want_b = k[1] * power, whole = *a + *b, most = fmax(want_a, want_b);
    const Vector share_a = *a / fmax(fmax(whole, want_a), TINY), share_b = *b / fmax(fmax(whole, want_b), TINY);
    if (own && any(whole < most)) {
        const Vector left = select(fmax(zero, 1.0f - share_a - share_b), zero, whole >= most) * power * k[5];
        const Vector before = *(__global Vector *)(light.dose + at), after = before + left;
        *(__global Vector *)(light.dose + at) = after;
        mark(light.optical_time + at, before, after, p.optical, time, k[5]);
        mark(light.mechanical_time + at, before, after, p.mechanical, time, k[5]);
    }
    *a = fmax(zero, *a - want_a * share_a);
    *b = fmax(zero, *b - want_b * share_b);
    const Vector rate = k[2] * uv, split = fmin(*c, p.order ? *c * rate : rate);
    const Vector paired = k[3] * *b * *b / (1.0f + 2.0f * k[3] * *b);
    *b = fmax(zero, *b + 2.0f * (split - paired));
    *c = *c - split + paired;
}

static inline float4 passages(const Problem p, int x, int y) {
    __global const uchar *open = p.open + (size_t)x * p.n_y + y;
    return (float4)(x ? open[-p.n_y] : 1, x + 1 < p.n_x ? open[p.n_y] : 1, y ? open[-1] : 1, y + 1 < p.n_y ? open[1] : 1);
}

// One step of WIDTH voxels of all species, from rows to rows; at is where they lie in a field.
static inline void advance(const Problem p, const Row *rows, __global float *const *out, Light light, int x, int y,
                           int slab, int base, float time, bool own) {
    const size_t at = (((size_t)slab * p.n_x + x) * p.n_y + y) * LANES + base;
    Vector s[SPECIES];
    if (p.open[(size_t)x * p.n_y + y]) {
        const float4 passes = passages(p, x, y);
        UNROLL for (int k = 0; k < SPECIES; k++) s[k] = spread_one(p, rows[k], k, x, y, slab, base, passes);
        if (p.reacting) react(p, s, s + 1, s + 2, light, at, time, own);
    } else
        UNROLL for (int k = 0; k < SPECIES; k++) s[k] = *(__global const Vector *)(rows[k].here + (long)y * LANES + base);
    UNROLL for (int k = 0; k < SPECIES; k++) *(__global Vector *)(out[k] + (long)y * LANES + base) = s[k];
}

#ifdef CPU
// Where row x of a species lies after `level` steps of the block: in the fields it came from or goes to, or in scratch,
// which keeps three planes of x of every step between.
typedef struct {
    __global float *from[SPECIES], *to[SPECIES], *scratch;
    int steps;
} Block;

static inline __global float *row_of(const Problem p, const Block b, int slabs, int level, int species, int slab, int x) {
    const size_t row = (size_t)p.n_y * LANES, field = ((size_t)slab * p.n_x + x) * row;
    if (level == 0) return b.from[species] + field;
    if (level == b.steps) return b.to[species] + field;
    return b.scratch + ((((level - 1) * 3 + x % 3) * SPECIES + species) * (size_t)slabs + slab) * row;
}

// Plane x of one step of the block.
static void advance_plane(const Problem p, const Block b, Light light, int level, int x, float time, bool own) {
    const int slabs = (p.n_z + LANES - 1) / LANES;
    for (int slab = 0; slab < slabs; slab++) {
        Row rows[SPECIES];
        __global float *out[SPECIES];
        UNROLL for (int k = 0; k < SPECIES; k++) {
            rows[k].here = row_of(p, b, slabs, level - 1, k, slab, x);
            rows[k].low = row_of(p, b, slabs, level - 1, k, slab, max(x - 1, 0));
            rows[k].high = row_of(p, b, slabs, level - 1, k, slab, min(x + 1, p.n_x - 1));
            rows[k].before = row_of(p, b, slabs, level - 1, k, max(slab - 1, 0), x);
            rows[k].behind = row_of(p, b, slabs, level - 1, k, min(slab + 1, slabs - 1), x);
            out[k] = row_of(p, b, slabs, level, k, slab, x);
        }
        for (int y = 0; y < p.n_y; y++)
            UNROLL for (int v = 0; v < VECTORS; v++) advance(p, rows, out, light, x, y, slab, v * WIDTH, time, own);
    }
}
#endif

// A CPU core walks its planes once, a step of the plane behind following each; its neighbors' planes it needs for that
// it steps as well. A GPU thread takes one step of four voxels.
FIELD_KERNEL transport(__global const float *a, __global const float *b, __global const float *c,
                       __global const float *visible, __global const float *ultraviolet, __global const uchar *open,
                       __global const float *spread, __global const float *walls, __global const float *rates,
                       int order, int reacting, float optical, float mechanical, float time, int steps,
                       __global float *scratch, __global float *a_out, __global float *b_out, __global float *c_out,
                       __global float *dose, __global float *optical_time, __global float *mechanical_time,
                       int n_x, int n_y, int n_z, int n_part, int n_room) {
    const Problem p = {spread, walls, rates, open, order, reacting, n_x, n_y, n_z, optical, mechanical};
    const Light light = {visible, ultraviolet, dose, optical_time, mechanical_time};
#ifdef CPU
    const int first = ITEM_MAJOR * TILE_MAJOR, last = min(first + TILE_MAJOR, n_x);
    if (first >= n_x) return;
    const Block block = {{(__global float *)a, (__global float *)b, (__global float *)c}, {a_out, b_out, c_out},
                         scratch + (size_t)ITEM_MAJOR * n_room, steps};
    for (int front = first - steps + 1; front < last + steps - 1; front++)
        for (int level = 1; level <= steps; level++) {
            const int x = front - (level - 1), halo = steps - level;
            if (x < max(first - halo, 0) || x >= min(last + halo, n_x)) continue;
            advance_plane(p, block, light, level, x, time + (level - 1) * rates[5], x >= first && x < last);
        }
#else
    const int x = ITEM_MAJOR, y = ITEM_MINOR, slab = ITEM_SLAB, slabs = (n_z + LANES - 1) / LANES;
    if (x >= n_x || y >= n_y) return;
    const size_t row = (size_t)n_y * LANES, at = ((size_t)slab * n_x + x) * row, next = (size_t)n_x * row;
    __global const float *from[SPECIES] = {a, b, c};
    __global float *to[SPECIES] = {a_out + at, b_out + at, c_out + at};
    Row rows[SPECIES];
    UNROLL for (int k = 0; k < SPECIES; k++) {
        rows[k].here = from[k] + at;
        rows[k].low = x ? rows[k].here - row : rows[k].here;
        rows[k].high = x + 1 < n_x ? rows[k].here + row : rows[k].here;
        rows[k].before = slab ? rows[k].here - next : rows[k].here;
        rows[k].behind = slab + 1 < slabs ? rows[k].here + next : rows[k].here;
    }
    advance(p, rows, to, light, x, y, slab, ITEM_LANE, time, true);
#endif
}
#endif
