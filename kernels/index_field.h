// n² and half its gradient at the positions of a pack of rays: `look`, whose arguments are declared by FIELD and named
// by LOOK. Splines are evaluated for four rays together; four coefficients of each are neighbors in memory: a Row.
#include "packs.h"
#ifdef CPU
#define QUADS 4
typedef float16 Row;
#define PUT_WHOLE(whole, where) vstore16(whole, 0, where)
#else
#define QUADS 1
typedef float4 Row;
#define PUT_WHOLE(whole, where) (*(where) = (whole))
#endif

typedef struct { Real x, y, z; } Triple;
typedef struct { Triple pull; Real square; } Medium;    // half the gradient of n², and n²

static inline Triple along(Triple a, Real share, Triple b) {
    return (Triple){fma(share, b.x, a.x), fma(share, b.y, a.y), fma(share, b.z, a.z)};
}
static inline Real inner(Triple a, Triple b) { return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z)); }

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
// The cells of positions, counted in cells, and the positions within them.
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
// The weight of each of four rays, repeated four times.
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
    UNROLL for (int quad = 0; quad < QUADS; quad++) {
        __global const float *cells[PACK / QUADS];
        Row rows[4], weights[4], slopes[4];
        UNROLL for (int s = 0; s < PACK / QUADS; s++) cells[s] = coefficients + first[4 * quad + s];
        UNROLL for (int s = 0; s < 4; s++) {
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
    UNROLL for (int quad = 0; quad < QUADS; quad++) {
        __global const float *cells[PACK / QUADS];
        Row along_x[4], slope_x[4], along_y[4], slope_y[4], level[4], steep[4];
        UNROLL for (int s = 0; s < PACK / QUADS; s++) cells[s] = coefficients + first[4 * quad + s];
        UNROLL for (int s = 0; s < 4; s++) {
            along_x[s] = spread(wx[s], quad);
            slope_x[s] = spread(dx[s], quad);
            along_y[s] = spread(wy[s], quad);
            slope_y[s] = spread(dy[s], quad);
        }
        UNROLL for (int s = 0; s < 4; s++) {
            Row rows[4];
            UNROLL for (int t = 0; t < 4; t++) rows[t] = row_at(cells, ((size_t)s * n_j + t) * n_k);
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
