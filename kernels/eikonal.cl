#include "index_field.h"

#define OUTER 1.35120719f       // Yoshida's shares of a step
#define INNER -1.70241438f
#define SHORTEN 5               // Newton steps for finding where a ray crosses the border
#define NEVER -1e30f

typedef struct { Triple place, heading; Medium here; } Ray;

static inline Triple chosen(Whole mask, Triple yes, Triple no) {
    return (Triple){mask ? yes.x : no.x, mask ? yes.y : no.y, mask ? yes.z : no.z};
}

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

// Optical path and length of a step, from the cubic through values and slopes at both ends.
static inline Way way_of(Ray ray, Ray end, Real h) {
    const Real first = inner(ray.here.pull, ray.heading), last = inner(end.here.pull, end.heading);
    const Real n0 = sqrt(ray.here.square), n1 = sqrt(end.here.square);
    return (Way){h * fma(h * (1.0f / 6.0f), first - last, 0.5f * (ray.here.square + end.here.square)),
                 h * fma(h * (1.0f / 12.0f), first / n0 - last / n1, 0.5f * (n0 + n1))};
}

// The rounding errors of hundreds of small steps are carried along.
static inline void add(Real *total, Real *rest, Real value, Whole live) {
    const Real wanted = value - *rest, sum = *total + wanted;
    *rest = live ? (sum - *total) - wanted : *rest;
    *total = live ? sum : *total;
}

// Distance of rays outside the region, only on the way out, and its growth per t.
static inline Real outside(__global const float *region, Ray ray, Real *growth) {
    const Triple weighted = {region[0] * ray.place.x, region[1] * ray.place.y, region[2] * ray.place.z};
    const Real place[3] = {ray.place.x, ray.place.y, ray.place.z};
    const Real heading[3] = {ray.heading.x, ray.heading.y, ray.heading.z};
    *growth = 2.0f * inner(weighted, ray.heading);
    Real worst = *growth > 0.0f ? inner(weighted, ray.place) - region[3] : (Real)NEVER;
    UNROLL for (int axis = 0; axis < 3; axis++) {
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

// last: number of rays that follow the first; lanes beyond repeat the last ray.
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
PACK_KERNEL march_formula(__global const float *restrict starts, __global const float *restrict formula,
                         __global const float *restrict region, float step, int steps, int scheme, int every,
                         __global float *restrict ends, __global float *restrict path, __global float *restrict times,
                         int n_ray, int n_row) {
    if (RAY % PACK == 0) run(formula, OWN);
}
#endif

#ifdef COMPILE_march_plane
PACK_KERNEL march_plane(__global const float *restrict starts, __global const float *restrict coefficients,
                       __global const float *restrict corner, __global const float *restrict region, float step,
                       int steps, int scheme, int every, __global float *restrict ends, __global float *restrict path,
                       __global float *restrict times, int n_ray, int n_i, int n_j, int n_row) {
    if (RAY % PACK == 0) run(coefficients, vload4(0, corner), n_i, n_j, OWN);
}
#endif

#ifdef COMPILE_march_volume
PACK_KERNEL march_volume(__global const float *restrict starts, __global const float *restrict coefficients,
                        __global const float *restrict corner, __global const float *restrict region, float step,
                        int steps, int scheme, int every, __global float *restrict ends, __global float *restrict path,
                        __global float *restrict times, int n_ray, int n_i, int n_j, int n_k, int n_row) {
    if (RAY % PACK == 0) run(coefficients, vload4(0, corner), n_i, n_j, n_k, OWN);
}
#endif
