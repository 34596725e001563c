#include "common.h"

// A ray is one long chain of dependent steps, so a core is kept busy by marching several at once: on a CPU an item owns
// PACK neighbouring rays, one a lane, and the items between do nothing. Splines are looked up for four rays together,
// four coefficients of each being neighbours in memory: a Row.
#ifdef CPU
#define PACK 16
#define QUADS 4
typedef float16 Real;
typedef int16 Whole;
typedef float16 Row;
#define TO_WHOLE convert_int16
#define TO_REAL convert_float16
#define ANY(mask) any(mask)
#define PUT_WHOLE(whole, where) vstore16(whole, 0, where)
#define RAY_KERNEL __kernel __attribute__((vec_type_hint(float16))) void
#else
#define PACK 1
#define QUADS 1
typedef float Real;
typedef int Whole;
typedef float4 Row;
#define TO_WHOLE convert_int
#define TO_REAL convert_float
#define ANY(mask) (mask)
#define PUT_WHOLE(whole, where) (*(where) = (whole))
#define RAY_KERNEL __kernel void
#endif
#define LOOP _Pragma("unroll")

#define OUTER 1.35120719f       // Yoshida's shares of a step
#define INNER -1.70241438f
#define SHORTEN 5               // Newton steps that find where a ray crosses the border
#define NEVER -1e30f

typedef struct { Real x, y, z; } Triple;
typedef struct { Triple pull; Real square; } Medium;    // half the gradient of n², and n²
typedef struct { Triple place, heading; Medium here; } Ray;

static inline Triple along(Triple a, Real share, Triple b) {
    return (Triple){fma(share, b.x, a.x), fma(share, b.y, a.y), fma(share, b.z, a.z)};
}
static inline Real inner(Triple a, Triple b) { return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z)); }
static inline Triple chosen(Whole mask, Triple yes, Triple no) {
    return (Triple){mask ? yes.x : no.x, mask ? yes.y : no.y, mask ? yes.z : no.z};
}

#ifdef COMPILE_march_formula
#define FIELD __global const float *formula
#define LOOK formula

static inline Medium look(FIELD, Triple at) {
    const Triple weighted = {formula[0] * at.x, formula[1] * at.y, formula[2] * at.z};
    const Real s = inner(weighted, at);
    const Real above = fma(s, fma(s, fma(s, (Real)formula[6], (Real)formula[5]), (Real)formula[4]), (Real)formula[3]);
    const Real below = fma(s, fma(s, fma(s, (Real)formula[10], (Real)formula[9]), (Real)formula[8]), (Real)formula[7]);
    const Real up = fma(s, fma(3.0f * s, (Real)formula[6], (Real)(2.0f * formula[5])), (Real)formula[4]);
    const Real down = fma(s, fma(3.0f * s, (Real)formula[10], (Real)(2.0f * formula[9])), (Real)formula[8]);
    const Real square = above / below, slope = (up - square * down) / below;
    return (Medium){{slope * weighted.x, slope * weighted.y, slope * weighted.z}, square};
}
#else
// The cells that positions, counted in cells, fall into, and how far into them.
static inline Whole cell_of(Real position, int corners, Real *into) {
    const Whole cell = TO_WHOLE(clamp(position, (Real)0.0f, (Real)(float)(corners - 4)));
    *into = clamp(position - TO_REAL(cell), (Real)-2.0f, (Real)3.0f);
    return cell;
}

// Weights of the four cubic B-splines over a cell, and their slopes.
static inline void splines(Real f, Real *weights, Real *slopes) {
    const Real g = 1.0f - f, ff = f * f, gg = g * g;
    weights[0] = gg * g * (1.0f / 6.0f);
    weights[1] = (2.0f / 3.0f) - 0.5f * ff * (1.0f + g);
    weights[2] = (2.0f / 3.0f) - 0.5f * gg * (1.0f + f);
    weights[3] = ff * f * (1.0f / 6.0f);
    slopes[0] = -0.5f * gg;
    slopes[1] = f * (1.5f * f - 2.0f);
    slopes[2] = g * (2.0f - 1.5f * g);
    slopes[3] = 0.5f * ff;
}

#ifdef CPU
static inline Row row_at(__global const float *const *cells, size_t beyond) {
    return (float16)(vload4(0, cells[0] + beyond), vload4(0, cells[1] + beyond), vload4(0, cells[2] + beyond),
                     vload4(0, cells[3] + beyond));
}
// The weight of each of four rays, four times over.
static inline Row spread(Real w, int quad) {
    return quad == 0 ? w.s0000111122223333 : quad == 1 ? w.s4444555566667777
         : quad == 2 ? w.s88889999aaaabbbb : w.sccccddddeeeeffff;
}
static inline Real folded(const Row *rows, const Real *w) {
    return fma(w[0], (float16)(rows[0].s048c, rows[1].s048c, rows[2].s048c, rows[3].s048c),
           fma(w[1], (float16)(rows[0].s159d, rows[1].s159d, rows[2].s159d, rows[3].s159d),
           fma(w[2], (float16)(rows[0].s26ae, rows[1].s26ae, rows[2].s26ae, rows[3].s26ae),
               w[3] * (float16)(rows[0].s37bf, rows[1].s37bf, rows[2].s37bf, rows[3].s37bf))));
}
#else
static inline Row row_at(__global const float *const *cells, size_t beyond) { return vload4(0, cells[0] + beyond); }
static inline Row spread(Real w, int quad) { return (float4)(w); }
static inline Real folded(const Row *rows, const Real *w) { return dot(rows[0], (float4)(w[0], w[1], w[2], w[3])); }
#endif

static inline Row across(const Row *weights, const Row *rows) {
    return fma(weights[0], rows[0], fma(weights[1], rows[1], fma(weights[2], rows[2], weights[3] * rows[3])));
}
#endif

#ifdef COMPILE_march_plane
#define FIELD __global const float *coefficients, float4 corner, int n_i, int n_j
#define LOOK coefficients, corner, n_i, n_j

static inline Medium look(FIELD, Triple at) {
    Real f, g, wx[4], dx[4], wy[4], dy[4];
    int first[PACK];
    const Whole i = cell_of((at.x - corner.x) * corner.w, n_i, &f);
    PUT_WHOLE(i * n_j + cell_of((at.y - corner.y) * corner.w, n_j, &g), first);
    splines(f, wx, dx);
    splines(g, wy, dy);
    Row even[QUADS], steep[QUADS];
    LOOP for (int quad = 0; quad < QUADS; quad++) {
        __global const float *cells[PACK / QUADS];
        Row rows[4], weights[4], slopes[4];
        LOOP for (int s = 0; s < PACK / QUADS; s++) cells[s] = coefficients + first[4 * quad + s];
        LOOP for (int s = 0; s < 4; s++) {
            rows[s] = row_at(cells, s * n_j);
            weights[s] = spread(wx[s], quad);
            slopes[s] = spread(dx[s], quad);
        }
        even[quad] = across(weights, rows);
        steep[quad] = across(slopes, rows);
    }
    const float scale = 0.5f * corner.w;
    return (Medium){{scale * folded(steep, wy), scale * folded(even, dy), (Real)0.0f}, folded(even, wy)};
}
#endif

#ifdef COMPILE_march_volume
#define FIELD __global const float *coefficients, float4 corner, int n_i, int n_j, int n_k
#define LOOK coefficients, corner, n_i, n_j, n_k

static inline Medium look(FIELD, Triple at) {
    Real f, g, h, wx[4], dx[4], wy[4], dy[4], wz[4], dz[4];
    int first[PACK];
    const Whole i = cell_of((at.x - corner.x) * corner.w, n_i, &f), j = cell_of((at.y - corner.y) * corner.w, n_j, &g);
    PUT_WHOLE((i * n_j + j) * n_k + cell_of((at.z - corner.z) * corner.w, n_k, &h), first);
    splines(f, wx, dx);
    splines(g, wy, dy);
    splines(h, wz, dz);
    Row even[QUADS], in_x[QUADS], in_y[QUADS];
    LOOP for (int quad = 0; quad < QUADS; quad++) {
        __global const float *cells[PACK / QUADS];
        Row along_x[4], slope_x[4], along_y[4], slope_y[4], level[4], steep[4];
        LOOP for (int s = 0; s < PACK / QUADS; s++) cells[s] = coefficients + first[4 * quad + s];
        LOOP for (int s = 0; s < 4; s++) {
            along_x[s] = spread(wx[s], quad);
            slope_x[s] = spread(dx[s], quad);
            along_y[s] = spread(wy[s], quad);
            slope_y[s] = spread(dy[s], quad);
        }
        LOOP for (int s = 0; s < 4; s++) {
            Row rows[4];
            LOOP for (int t = 0; t < 4; t++) rows[t] = row_at(cells, ((size_t)s * n_j + t) * n_k);
            level[s] = across(along_y, rows);
            steep[s] = across(slope_y, rows);
        }
        even[quad] = across(along_x, level);
        in_x[quad] = across(slope_x, level);
        in_y[quad] = across(along_x, steep);
    }
    const float scale = 0.5f * corner.w;
    return (Medium){{scale * folded(in_x, wz), scale * folded(in_y, wz), scale * folded(even, dz)}, folded(even, wz)};
}
#endif

// ---- steps ---------------------------------------------------------------------------------------------------------
static inline Ray leap(FIELD, Ray ray, Real h) {
    const Triple half_way = along(ray.heading, 0.5f * h, ray.here.pull), place = along(ray.place, h, half_way);
    const Medium here = look(LOOK, place);
    return (Ray){place, along(half_way, 0.5f * h, here.pull), here};
}

static inline Ray advance(FIELD, Ray ray, Real h, int scheme) {
    if (scheme == 1) return leap(LOOK, ray, h);
    if (scheme == 2) return leap(LOOK, leap(LOOK, leap(LOOK, ray, OUTER * h), INNER * h), OUTER * h);
    const Triple a = ray.here.pull;
    const Triple b = look(LOOK, along(along(ray.place, 0.5f * h, ray.heading), 0.125f * h * h, a)).pull;
    const Triple c = look(LOOK, along(along(ray.place, h, ray.heading), 0.5f * h * h, b)).pull;
    const Real sixth = h * (1.0f / 6.0f);
    const Triple drift = along(ray.heading, sixth, along(a, (Real)2.0f, b));
    const Triple place = along(ray.place, h, drift);
    return (Ray){place, along(ray.heading, sixth, along(along(a, (Real)4.0f, b), (Real)1.0f, c)), look(LOOK, place)};
}

typedef struct { Real optical, length; } Way;

// Optical path and length of a step, by the cubic through values and slopes at both ends.
static inline Way way_of(Ray ray, Ray end, Real h) {
    const Real first = inner(ray.here.pull, ray.heading), last = inner(end.here.pull, end.heading);
    const Real n0 = sqrt(ray.here.square), n1 = sqrt(end.here.square);
    return (Way){h * fma(h * (1.0f / 6.0f), first - last, 0.5f * (ray.here.square + end.here.square)),
                 h * fma(h * (1.0f / 12.0f), first / n0 - last / n1, 0.5f * (n0 + n1))};
}

// What rounding leaves of hundreds of small steps is carried along.
static inline void add(Real *total, Real *rest, Real value, Whole live) {
    const Real wanted = value - *rest, sum = *total + wanted;
    *rest = live ? (sum - *total) - wanted : *rest;
    *total = live ? sum : *total;
}

// How far outside the region rays are, on the way out only, and its growth per t.
static inline Real outside(__global const float *region, Ray ray, Real *growth) {
    const Triple weighted = {region[0] * ray.place.x, region[1] * ray.place.y, region[2] * ray.place.z};
    const Real place[3] = {ray.place.x, ray.place.y, ray.place.z};
    const Real heading[3] = {ray.heading.x, ray.heading.y, ray.heading.z};
    *growth = 2.0f * inner(weighted, ray.heading);
    Real worst = *growth > 0.0f ? inner(weighted, ray.place) - region[3] : (Real)NEVER;
    LOOP for (int axis = 0; axis < 3; axis++) {
        const Real value = heading[axis] > 0.0f ? place[axis] - region[7 + axis] : region[4 + axis] - place[axis];
        const Whole more = (heading[axis] != 0.0f) & (value > worst);
        worst = more ? value : worst;
        *growth = more ? fabs(heading[axis]) : *growth;
    }
    return worst;
}

// ---- memory --------------------------------------------------------------------------------------------------------
static inline Real taken(__global const float *from, int stride, int last) {
    Real value;
    for (int s = 0; s < PACK; s++) ((float *)&value)[s] = from[(size_t)min(s, last) * stride];
    return value;
}
static inline void put(Real value, __global float *to, size_t stride, int last) {
    for (int s = 0; s < PACK && s <= last; s++) to[s * stride] = ((const float *)&value)[s];
}
static inline void put_triple(Triple value, __global float *to, size_t stride, int last) {
    put(value.x, to, stride, last);
    put(value.y, to + 1, stride, last);
    put(value.z, to + 2, stride, last);
}

// last: of the rays that follow the first; lanes beyond repeat it.
static inline void run(FIELD, __global const float *starts, __global const float *region, float step, int steps, int scheme,
                       int every, __global float *ends, __global float *path, __global float *times, int n_row, int last) {
    const size_t stride = (size_t)3 * n_row;
    Ray ray = {{taken(starts, 6, last), taken(starts + 1, 6, last), taken(starts + 2, 6, last)},
               {taken(starts + 3, 6, last), taken(starts + 4, 6, last), taken(starts + 5, 6, last)}};
    ray.here = look(LOOK, ray.place);
    Way way = {(Real)0.0f, (Real)0.0f}, rest = way;
    Whole live = ray.place.x == ray.place.x;
    Real taken_steps = (Real)0.0f, growth, h = (Real)0.0f;
    int row = 1, due = every;
    put_triple(ray.place, path, stride, last);
    for (int k = 0; k < steps && ANY(live); k++) {
        const Ray end = advance(LOOK, ray, (Real)step, scheme);
        live &= !(outside(region, end, &growth) > 0.0f);
        const Way more = way_of(ray, end, (Real)step);
        add(&way.optical, &rest.optical, more.optical, live);
        add(&way.length, &rest.length, more.length, live);
        ray.place = chosen(live, end.place, ray.place);
        ray.heading = chosen(live, end.heading, ray.heading);
        ray.here.pull = chosen(live, end.here.pull, ray.here.pull);
        ray.here.square = live ? end.here.square : ray.here.square;
        taken_steps = live ? (Real)(float)(k + 1) : taken_steps;
        if (k + 1 == due && row < n_row) {
            put_triple(ray.place, path + 3 * row++, stride, last);
            due += every;
        }
    }
    if (ANY(!live)) {
        h = (Real)step;
        for (int s = 0; s < SHORTEN; s++) {
            const Real beyond = outside(region, advance(LOOK, ray, h, scheme), &growth);
            const Real shorter = clamp(h - beyond / fmax(growth, (Real)1e-30f), (Real)0.0f, (Real)step);
            h = beyond > 0.99f * NEVER ? shorter : h;
        }
        h = live ? (Real)0.0f : h;
        const Ray end = advance(LOOK, ray, h, scheme);
        const Way more = way_of(ray, end, h);
        way.optical += more.optical;
        way.length += more.length;
        ray = end;
    }
    for (int s = 0; s < PACK && s <= last; s++) {
        const float *x = (const float *)&ray.place.x + s, *y = (const float *)&ray.place.y + s;
        const float *z = (const float *)&ray.place.z + s;
        for (int after = (int)((const float *)&taken_steps)[s] / every + 1; after < n_row; after++)
            vstore3((float3)(*x, *y, *z), after, path + s * stride);
    }
    put_triple(ray.place, ends, 8, last);
    put_triple(ray.heading, ends + 3, 8, last);
    put(way.optical, ends + 6, 8, last);
    put(way.length, ends + 7, 8, last);
    put(live ? (Real)-1.0f : fma(taken_steps, (Real)step, h), times, 1, last);
}

#define RAY ((int)get_global_id(0))
#define OWN starts + 6 * RAY, region, step, steps, scheme, every, ends + 8 * RAY, path + (size_t)3 * n_row * RAY, \
            times + RAY, n_row, n_ray - RAY - 1

#ifdef COMPILE_march_formula
RAY_KERNEL march_formula(__global const float *restrict starts, __global const float *restrict formula,
                         __global const float *restrict region, float step, int steps, int scheme, int every,
                         __global float *restrict ends, __global float *restrict path, __global float *restrict times,
                         int n_ray, int n_row) {
    if (RAY % PACK == 0) run(formula, OWN);
}
#endif

#ifdef COMPILE_march_plane
RAY_KERNEL march_plane(__global const float *restrict starts, __global const float *restrict coefficients,
                       __global const float *restrict corner, __global const float *restrict region, float step,
                       int steps, int scheme, int every, __global float *restrict ends, __global float *restrict path,
                       __global float *restrict times, int n_ray, int n_i, int n_j, int n_row) {
    if (RAY % PACK == 0) run(coefficients, vload4(0, corner), n_i, n_j, OWN);
}
#endif

#ifdef COMPILE_march_volume
RAY_KERNEL march_volume(__global const float *restrict starts, __global const float *restrict coefficients,
                        __global const float *restrict corner, __global const float *restrict region, float step,
                        int steps, int scheme, int every, __global float *restrict ends, __global float *restrict path,
                        __global float *restrict times, int n_ray, int n_i, int n_j, int n_k, int n_row) {
    if (RAY % PACK == 0) run(coefficients, vload4(0, corner), n_i, n_j, n_k, OWN);
}
#endif
