#include "partial.h"

#ifdef COMPILE_transport
#define SPECIES 3
#define SPACING 256 // floats between rows of scratch, which would otherwise use the same sets of the cache
#define TINY 1e-30f
#define NOTHING 1e-20f
#define VECTOR_AT(pointer) (*(__global const Vector *)(pointer))
// Neighbors in z of the lanes of a vector, from it and the one before or after it.
#define AFTER_16(c, next) shuffle2(c, next, (uint16)(1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16))
#define BEFORE_16(c, last) shuffle2(last, c, (uint16)(15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30))
#define AFTER_4(c, next) ((float4)(c.s123, next.s0))
#define BEFORE_4(c, last) ((float4)(last.s3, c.s012))
#define AFTER PASTE(AFTER_, WIDTH)
#define BEFORE PASTE(BEFORE_, WIDTH)

// A CPU's item works long on one copy of the numbers, which no store may change; a GPU's item reads them when needed.
typedef struct {
#ifdef CPU
    float spread[SPECIES][3], walls[SPECIES][6][2], rates[6];
#else
    __global const float (*spread)[3], (*walls)[6][2], *rates;
#endif
    __global const uchar *open;
    int order, n_x, n_y, n_z;
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

// A species after diffusion, all lanes of the item; passes: 1 for the open faces x low, x high, y low, y high. inner:
// all of them are open, and none is the box's.
static inline void spread_one(const Problem *p, Row row, int k, int x, int y, int slab, int lane, float4 passes,
                              bool inner, Vector *out) {
    const long sample = (long)y * LANES;
    __global const float *at = row.here + sample + lane;
    const int top = p->n_z - 1 - slab * LANES - lane;
    Vector here[VECTORS + 2];
    EACH_VECTOR here[v + 1] = VECTOR_AT(at + v * WIDTH);
    here[0] = (Vector)(lane ? at[-1] : slab ? row.before[sample + LANES - 1] : p->walls[k][4][0] + p->walls[k][4][1] * at[0]);
    here[VECTORS + 1] = (Vector)(lane + VECTORS * WIDTH < LANES ? at[VECTORS * WIDTH]
                                 : top >= VECTORS * WIDTH       ? row.behind[sample]
                                                                : 0.0f);
    EACH_VECTOR {
        const Vector own = here[v + 1];
        const size_t near = sample + lane + v * WIDTH;
        const Vector x_low = inner || x ? VECTOR_AT(row.low + near) : p->walls[k][0][0] + p->walls[k][0][1] * own;
        const Vector x_high = inner || x + 1 < p->n_x ? VECTOR_AT(row.high + near) : p->walls[k][1][0] + p->walls[k][1][1] * own;
        const Vector y_low = inner || y ? VECTOR_AT(at + v * WIDTH - LANES) : p->walls[k][2][0] + p->walls[k][2][1] * own;
        const Vector y_high =
            inner || y + 1 < p->n_y ? VECTOR_AT(at + v * WIDTH + LANES) : p->walls[k][3][0] + p->walls[k][3][1] * own;
        const Vector z_low = BEFORE(own, here[v]);
        Vector z_high = AFTER(own, here[v + 2]);
        if (top < VECTORS * WIDTH)
            z_high = select(z_high, p->walls[k][5][0] + p->walls[k][5][1] * own, LANE_IDS == (Lanes)(top - v * WIDTH));
        const Vector twice = -2.0f * own;
        Vector sum = fma((Vector)(p->spread[k][2]), z_low + z_high + twice, own);
        if (inner) {
            sum = fma((Vector)(p->spread[k][0]), x_low + x_high + twice, sum);
            out[v] = fma((Vector)(p->spread[k][1]), y_low + y_high + twice, sum);
        } else {
            sum = fma((Vector)(p->spread[k][0]), passes.x * (x_low - own) + passes.y * (x_high - own), sum);
            out[v] = fma((Vector)(p->spread[k][1]), passes.z * (y_low - own) + passes.w * (y_high - own), sum);
        }
    }
}

static inline void mark(__global float *when, Vector before, Vector after, float level, float time, float step) {
    const Lanes now = (before < (Vector)(level)) & (after >= (Vector)(level));
    if (!any(now)) return;
    const Vector at = time + step * (level - before) / (after - before);
    *(__global Vector *)when = select(*(__global Vector *)when, at, now);
}

// Values of at most NOTHING become 0: arithmetic with denormal numbers is slow.
static inline Vector settled(Vector value) {
    return select((Vector)(0.0f), value, value > (Vector)(NOTHING));
}

// Reactions of one step in place; adds to the dose only in a voxel that the item owns.
static inline void react(const Problem *p, Vector *a, Vector *b, Vector *c, Light light, size_t at, float time, bool own) {
    const Vector zero = (Vector)(0.0f);
    const Vector uv = *(__global const Vector *)(light.ultraviolet + at);
    const Vector power = *(__global const Vector *)(light.visible + at) + p->rates[4] * uv;
    const Vector want_a = p->rates[0] * power, want_b = p->rates[1] * power, whole = *a + *b, most = fmax(want_a, want_b);
    const Vector share_a = *a / fmax(fmax(whole, want_a), TINY), share_b = *b / fmax(fmax(whole, want_b), TINY);
    if (own && any(whole < most)) {
        const Vector left = select(fmax(zero, 1.0f - share_a - share_b), zero, whole >= most) * power * p->rates[5];
        const Vector before = *(__global Vector *)(light.dose + at), after = before + left;
        *(__global Vector *)(light.dose + at) = after;
        mark(light.optical_time + at, before, after, p->optical, time, p->rates[5]);
        mark(light.mechanical_time + at, before, after, p->mechanical, time, p->rates[5]);
    }
    *a = settled(*a - want_a * share_a);
    *b = settled(*b - want_b * share_b);
    const Vector rate = p->rates[2] * uv, split = fmin(*c, p->order ? *c * rate : rate);
    const Vector paired = p->rates[3] * *b * *b / (1.0f + 2.0f * p->rates[3] * *b);
    *b = settled(*b + 2.0f * (split - paired));
    *c = *c - split + paired;
}

static inline float4 passages(const Problem *p, int x, int y) {
    __global const uchar *open = p->open + (size_t)x * p->n_y + y;
    return (float4)(x ? open[-p->n_y] : 1, x + 1 < p->n_x ? open[p->n_y] : 1, y ? open[-1] : 1,
                    y + 1 < p->n_y ? open[1] : 1);
}

// One step of the item's voxels of sample (x, y), all species, from rows to rows.
static inline void advance(const Problem *p, const Row *rows, __global float *const *out, Light light, int x, int y,
                           int slab, int lane, float time, bool own, bool inner, bool reacting) {
    const size_t at = (((size_t)slab * p->n_x + x) * p->n_y + y) * LANES + lane;
    const long near = (long)y * LANES + lane;
    Vector s[SPECIES][VECTORS];
    if (p->open[(size_t)x * p->n_y + y]) {
        const float4 passes = passages(p, x, y);
        const bool free = inner && passes.x + passes.y + passes.z + passes.w == 4.0f;
        if (free) {
            UNROLL for (int k = 0; k < SPECIES; k++) spread_one(p, rows[k], k, x, y, slab, lane, passes, true, s[k]);
        } else {
            UNROLL for (int k = 0; k < SPECIES; k++) spread_one(p, rows[k], k, x, y, slab, lane, passes, false, s[k]);
        }
        if (reacting) EACH_VECTOR react(p, s[0] + v, s[1] + v, s[2] + v, light, at + v * WIDTH, time, own);
    } else
        UNROLL for (int k = 0; k < SPECIES; k++) EACH_VECTOR s[k][v] = VECTOR_AT(rows[k].here + near + v * WIDTH);
    UNROLL for (int k = 0; k < SPECIES; k++) EACH_VECTOR STORE(out[k] + near, s[k][v]);
}

#ifdef CPU
// Position of row x of a species after `level` steps of the block: in the source or target fields, or in scratch, which
// keeps three planes of x of every intermediate step.
typedef struct {
    __global float *from[SPECIES], *to[SPECIES], *scratch;
    int steps;
} Block;

static inline __global float *row_of(const Problem *p, const Block *b, int level, int species, int slab, int x) {
    const size_t row = (size_t)p->n_y * LANES, field = ((size_t)slab * p->n_x + x) * row;
    if (level == 0) return b->from[species] + field;
    if (level == b->steps) return b->to[species] + field;
    const size_t slabs = (p->n_z + LANES - 1) / LANES;
    return b->scratch + ((((level - 1) * 3 + x % 3) * SPECIES + species) * slabs + slab) * (row + SPACING);
}

// Plane x of one step of the block.
static inline void advance_plane(const Problem *p, const Block *b, Light light, int level, int x, float time, bool own,
                                 bool reacting) {
    const int slabs = (p->n_z + LANES - 1) / LANES;
    for (int slab = 0; slab < slabs; slab++) {
        Row rows[SPECIES];
        __global float *out[SPECIES];
        UNROLL for (int k = 0; k < SPECIES; k++) {
            rows[k].here = row_of(p, b, level - 1, k, slab, x);
            rows[k].low = row_of(p, b, level - 1, k, slab, max(x - 1, 0));
            rows[k].high = row_of(p, b, level - 1, k, slab, min(x + 1, p->n_x - 1));
            rows[k].before = row_of(p, b, level - 1, k, max(slab - 1, 0), x);
            rows[k].behind = row_of(p, b, level - 1, k, min(slab + 1, slabs - 1), x);
            out[k] = row_of(p, b, level, k, slab, x);
        }
        const bool inside = x && x + 1 < p->n_x;
        const int first = inside ? min(1, p->n_y) : p->n_y, last = inside ? max(p->n_y - 1, first) : p->n_y;
        for (int y = 0; y < first; y++) advance(p, rows, out, light, x, y, slab, 0, time, own, false, reacting);
        for (int y = first; y < last; y++) advance(p, rows, out, light, x, y, slab, 0, time, own, true, reacting);
        for (int y = last; y < p->n_y; y++) advance(p, rows, out, light, x, y, slab, 0, time, own, false, reacting);
    }
}
#endif

// A CPU core goes through its planes once; each is followed by a step of the plane behind. It also steps the
// neighboring planes that it needs. A GPU thread takes one step of four lanes along a run of x.
FIELD_KERNEL transport(__global const float *a, __global const float *b, __global const float *c,
                       __global const float *visible, __global const float *ultraviolet, __global const uchar *open,
                       __global const float *spread, __global const float *walls, __global const float *rates,
                       int order, int reacting, float optical, float mechanical, float time, int steps,
                       __global float *scratch, __global float *a_out, __global float *b_out, __global float *c_out,
                       __global float *dose, __global float *optical_time, __global float *mechanical_time,
                       int n_x, int n_y, int n_z, int n_part, int n_room) {
    Problem p = {.open = open, .order = order, .n_x = n_x, .n_y = n_y, .n_z = n_z,
                 .optical = optical, .mechanical = mechanical};
#ifdef CPU
    for (int i = 0; i < SPECIES * 3; i++) p.spread[i / 3][i % 3] = spread[i];
    for (int i = 0; i < SPECIES * 12; i++) p.walls[i / 12][i / 2 % 6][i % 2] = walls[i];
    for (int i = 0; i < 6; i++) p.rates[i] = rates[i];
#else
    p.spread = (__global const float (*)[3])spread;
    p.walls = (__global const float (*)[6][2])walls;
    p.rates = rates;
#endif
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
            const float now = time + (level - 1) * rates[5];
            const bool own = x >= first && x < last;
            if (reacting)
                advance_plane(&p, &block, light, level, x, now, own, true);
            else
                advance_plane(&p, &block, light, level, x, now, own, false);
        }
#else
    const int y = ITEM_MINOR, slab = ITEM_SLAB, slabs = (n_z + LANES - 1) / LANES;
    if (y >= n_y) return;
    for (int x = ITEM_MAJOR * TILE_MAJOR; x < min((ITEM_MAJOR + 1) * TILE_MAJOR, n_x); x++) {
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
        const bool inner = x && x + 1 < n_x && y && y + 1 < n_y;
        advance(&p, rows, to, light, x, y, slab, ITEM_LANE, time, true, inner, reacting);
    }
#endif
}
#endif
