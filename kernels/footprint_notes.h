// Footprints on a processor: those of WIDTH neighbouring voxels at once.
#include "folds.h"
#define CONVERT_INT PASTE(convert_int, WIDTH)
#define LANE_NUMBERS (Vector)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
#include "footprint.h"

// Footprints take longer than the lanes that use them. Therefore WIDTH neighbouring voxels of a row compute theirs at
// once, for a block of angles; each is then applied to every slab and, if a quarter turn maps grid and angles onto
// themselves, to all four quarters (folds).
typedef struct {
    int first[ANGLES][WIDTH];               // column
    int taps[ANGLES];                       // number of columns from there on that light any of the voxels
    float weight[ANGLES][TAPS][WIDTH];
    bool lit[WIDTH];
} Notes;

// The angles, the light and the pixels' shape, in the form that every item needs.
typedef struct {
    __global const float *directions;
    __global const float4 *light;
    int n_angle, n_r, n_across, n_along, n_x, n_y, bent;
    float ratio, strength, fill, sigma, radius;
} Scene;

static inline Foot footprints(const Scene *k, float3 direction, float x, float y, Real *u) {
    if (!k->bent) {
        const Real column = y + LANE_NUMBERS;
        *u = (column * direction.x - x * direction.y) * k->ratio + 0.5f * (k->n_r - 1);
        const Real moved = fabs(k->ratio * direction.z * (column * direction.y + x * direction.x));
        return foot_of((Real)(fabs(k->ratio * direction.y)), (Real)(fabs(k->ratio * direction.x)), moved,
                       (Real)(k->strength), k->fill, k->sigma);
    }
    float column[WIDTH], strength[WIDTH], a[WIDTH], b[WIDTH], c[WIDTH];
    for (int lane = 0; lane < WIDTH; lane++) {
        const float4 ray = look_up(k->light, k->n_across, k->n_along, direction.xy, x, y + lane);
        column[lane] = ray.x;
        strength[lane] = ray.y;
        a[lane] = fabs(ray.z * direction.y + ray.w * direction.x);
        b[lane] = fabs(ray.z * direction.x - ray.w * direction.y);
        c[lane] = swept(ray.zw, direction, x, y + lane);
    }
    *u = VLOAD(0, column);
    return foot_of(VLOAD(0, a), VLOAD(0, b), VLOAD(0, c), VLOAD(0, strength), k->fill, k->sigma);
}

static inline float greatest(Real value) {
    float lanes[WIDTH], most = 0.0f;
    VSTORE(value, 0, lanes);
    for (int lane = 0; lane < WIDTH; lane++) most = fmax(most, lanes[lane]);
    return most;
}

// Stores columns [skip, skip + taps) of those that light voxels (row, column..), at `count` angles; false if none.
static inline bool note(const Scene *k, Notes *notes, int angle, int count, int row, int column, int skip, int taps) {
    const float x = row - 0.5f * (k->n_x - 1), y = column - 0.5f * (k->n_y - 1);
    const float inverse_sigma = k->sigma > 0.0f ? 1.0f / k->sigma : 0.0f;
    bool any = false;
    for (int lane = 0; lane < WIDTH; lane++) {
        notes->lit[lane] = column + lane < k->n_y && within(x, y + lane, k->radius);
        any |= notes->lit[lane];
    }
    if (!any) return false;
    for (int pose = 0; pose < count; pose++) {
        Real u;
        const Foot foot = footprints(k, vload3(angle + pose, k->directions), x, y, &u);
        const Real first = ceil(u - foot.reach) + skip;
        VSTORE(CONVERT_INT(first), 0, notes->first[pose]);
        const int most = clamp((int)(2.0f * greatest(foot.reach)) + 1 - skip, 0, taps);
        notes->taps[pose] = most;
        Real distance = u - first, above = edge(&foot, distance + 0.5f * k->fill, k->sigma, inverse_sigma);
        for (int tap = 0; tap < most; tap++, distance -= 1.0f) {
            const Real below = edge(&foot, distance - 0.5f * k->fill, k->sigma, inverse_sigma);
            VSTORE(faded(&foot, distance, k->sigma) * foot.gain * fmax(above - below, 0.0f), 0, notes->weight[pose][tap]);
            above = k->fill == 1.0f ? below : edge(&foot, distance - 1.0f + 0.5f * k->fill, k->sigma, inverse_sigma);
        }
    }
    return true;
}

static inline size_t turned_row(const Scene *k, int fold, int angle) {
    return (size_t)((angle + fold * (k->n_angle / 4)) % k->n_angle) * k->n_r * LANES;
}
// The share [x, y) of `count` things for item `index` of `items`.
static inline int2 part_of(int index, int items, int count) {
    return (int2)((int)((long)index * count / items), (int)((long)(index + 1) * count / items));
}
// Taps of [0, count) whose columns, from `first` on, lie in the beam.
static inline int2 taps_in(int first, int count, int n_r) { return (int2)(max(-first, 0), min(count, n_r - first)); }
