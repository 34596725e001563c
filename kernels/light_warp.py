"""The light of one angle at a voxel in Warp: from a table of that angle, with bounds from the chords of a column."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import READ_WIDE

wp.set_module_options({"enable_backward": False})


@wp.func_native("const char* at = (const char*)table.data + (size_t)i * table.strides[0] + (size_t)j * 16;" + READ_WIDE)
def node(table: wp.array3d[float], i: int, j: int) -> wp.vec4:  # type: ignore[empty-body]
    """A sample of a table, in one load."""
    ...


@wp.func
def sampled(table: wp.array3d[float], across: float, along: float):
    """Linear between the samples and beyond the edge, at a position counted in samples from the middle of the table."""
    u = across + 0.5 * float(table.shape[0] - 1)
    v = along + 0.5 * float(table.shape[1] - 1)
    i = wp.clamp(int(u), 0, table.shape[0] - 2)
    j = wp.clamp(int(v), 0, table.shape[1] - 2)
    b = v - float(j)
    near = node(table, i, j)
    near += b * (node(table, i, j + 1) - near)
    far = node(table, i + 1, j)
    far += b * (node(table, i + 1, j + 1) - far)
    return near + (u - float(i)) * (far - near)


@wp.struct
class Span:
    """The cells of each plane between which the light of some columns may fall, from the chords on either side."""

    along_y: int  # planes are of constant y
    planes: int
    cells: int  # of a plane
    low: wp.vec2  # crossing with plane 0, and shift per plane
    high: wp.vec2
    slack: float


@wp.func
def line(edges: wp.array2d[float], r: int, side: int, pose: wp.vec4, along_y: int, planes: int, cells: int):
    """Where a chord (p, cos d, sin d), rotated to one angle, crosses plane 0, and its shift from plane to plane."""
    c = pose[0] * edges[r, side + 1] - pose[1] * edges[r, side + 2]
    s = pose[1] * edges[r, side + 1] + pose[0] * edges[r, side + 2]
    p = edges[r, side] - pose[2] * edges[r, side + 1] - pose[3] * edges[r, side + 2]
    slope = s / c
    start = p / c
    if along_y == 1:
        slope = c / s
        start = -p / s
    return wp.vec2(start - 0.5 * float(planes - 1) * slope + 0.5 * float(cells - 1), slope)


@wp.func
def span_of(edges: wp.array2d[float], first: int, final: int, pose: wp.vec4, n_x: int, n_y: int):
    """The span of columns first to final, in the planes that the first chord crosses most steeply."""
    c = pose[0] * edges[first, 1] - pose[1] * edges[first, 2]
    s = pose[1] * edges[first, 1] + pose[0] * edges[first, 2]
    span = Span()
    span.along_y = wp.where(wp.abs(s) > wp.abs(c), 1, 0)
    span.planes = wp.where(span.along_y == 1, n_y, n_x)
    span.cells = wp.where(span.along_y == 1, n_x, n_y)
    span.low = line(edges, first, 0, pose, span.along_y, span.planes, span.cells)
    span.high = line(edges, final, 4, pose, span.along_y, span.planes, span.cells)
    slack = float(0.0)
    for column in range(first, final + 1):
        slack = wp.max(slack, edges[column, 3])
    span.slack = slack
    return span


@wp.func
def cells_of(span: Span, plane: int):
    """First and last cell of a plane."""
    a = span.low[0] + float(plane) * span.low[1]
    b = span.high[0] + float(plane) * span.high[1]
    first = int(wp.ceil(wp.min(a, b) - span.slack))
    return wp.vec2i(wp.max(first, 0), wp.min(int(wp.floor(wp.max(a, b) + span.slack)), span.cells - 1))
