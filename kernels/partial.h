// Partial results of a work item that owns TILE_MAJOR rows (0 = all) and TILE_MINOR samples of each (0 = all).
#include "common.h"
#ifdef LANES

#define LANE_IDS_16 (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
#define LANE_IDS_4 (0, 1, 2, 3)
typedef PASTE(int, WIDTH) Lanes;
#define LANE_IDS ((Lanes)PASTE(LANE_IDS_, WIDTH))

// All ones where lane k of vector v is a slice of the field, zero where it is padding.
#define REAL_LANES ((ITEM_Z + v * WIDTH + LANE_IDS) < (Lanes)(n_z))
#define ZERO ((Vector)(0.0f))

#define I_BEGIN (TILE_MAJOR ? ITEM_MAJOR * TILE_MAJOR : 0)
#define I_END (TILE_MAJOR ? min(I_BEGIN + TILE_MAJOR, n_i) : n_i)
#define ARRAY __global const float *
#define SIZES int n_i, int n_j, int n_z
// Every vector of this item's samples, at position `at` of a field.
#define EACH_VECTOR_AT                                                                                                 \
    const size_t slab = slab_offset(n_i, n_j);                                                                         \
    EACH_SAMPLE for (size_t at = slab + SAMPLE(i, j, n_j), end = at + 1; at < end; at++) EACH_VECTOR
#define EACH_SAMPLE for (int i = I_BEGIN; i < I_END; i++) EACH_MINOR(j, n_j)

// Position of this item's partial result; -1 for items that only pad a work-group.
static inline int part_index(int n_i, int n_j, int n_z) {
    const int minor = TILE_MINOR ? (n_j + TILE_MINOR - 1) / max(TILE_MINOR, 1) : 1;
    const int major = TILE_MAJOR ? (n_i + TILE_MAJOR - 1) / max(TILE_MAJOR, 1) : 1;
    const int inside = ITEM_MINOR < minor && ITEM_MAJOR < major;
    return inside ? (ITEM_SLAB * major + ITEM_MAJOR) * minor * THREADS + (int)get_global_id(0) : -1;
}

#define OWN_PART const int part = part_index(n_i, n_j, n_z); if (part < 0 || part >= n_part) return

// Whether this item does more than fill up a work-group.
#define MINE (part_index(n_i, n_j, n_z) >= 0)

#endif
