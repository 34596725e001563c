// The light of one angle at a voxel: from a table of that angle, with bounds from the chords of a column.
#include "common.h"

// A table of n_across x n_along samples, linear between them and beyond its edge.
static inline float4 sampled(__global const float4 *restrict table, int n_across, int n_along, float across, float along) {
    const int i = clamp((int)across, 0, n_across - 2), j = clamp((int)along, 0, n_along - 2);
    const float a = across - i, b = along - j;
    __global const float4 *here = table + i * n_along + j;
    const float4 near = here[0] + b * (here[1] - here[0]);
    const float4 far = here[n_along] + b * (here[n_along + 1] - here[n_along]);
    return near + a * (far - near);
}

// Half-integers below 2048 have exact squares in float32; every device therefore agrees on each voxel.
static inline bool within(float x, float y, float radius) { return x * x + y * y <= radius * radius; }

// The cells of plane `plane` between which one column's light may fall, from the chords on either side of it.
typedef struct {
    bool along_y;               // planes are of constant y
    int planes, cells;
    float2 from, to;            // crossing with plane 0, and shift per plane, of either chord
    float slack;
} Span;

// Where a chord (p, cos d, sin d), rotated to one angle, crosses plane 0, and its shift from plane to plane.
static inline float2 line(float4 chord, float4 pose, bool along_y, float planes_middle, float cells_middle) {
    const float c = pose.x * chord.y - pose.y * chord.z, s = pose.y * chord.y + pose.x * chord.z;
    const float p = chord.x - pose.z * chord.y - pose.w * chord.z;        // the chord is y c - x s = p
    const float slope = along_y ? c / s : s / c, start = along_y ? -p / s : p / c;
    return (float2)(start - planes_middle * slope + cells_middle, slope);
}

// The chord's own direction decides which planes it crosses most steeply.
static inline Span span_of(float8 edge, float4 pose, int n_x, int n_y) {
    const float4 low = edge.lo, high = edge.hi;
    const float c = pose.x * low.y - pose.y * low.z, s = pose.y * low.y + pose.x * low.z;
    Span span;
    span.along_y = fabs(s) > fabs(c);
    span.planes = span.along_y ? n_y : n_x;
    span.cells = span.along_y ? n_x : n_y;
    const float planes_middle = 0.5f * (span.planes - 1), cells_middle = 0.5f * (span.cells - 1);
    span.from = line(low, pose, span.along_y, planes_middle, cells_middle);
    span.to = line(high, pose, span.along_y, planes_middle, cells_middle);
    span.slack = low.w;
    return span;
}

static inline int2 cells_of(const Span *span, int plane) {
    const float a = span->from.x + plane * span->from.y, b = span->to.x + plane * span->to.y;
    return (int2)(max((int)ceil(fmin(a, b) - span->slack), 0), min((int)floor(fmax(a, b) + span->slack), span->cells - 1));
}
