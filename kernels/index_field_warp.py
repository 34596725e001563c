"""Squared refractive index and half its gradient in Warp; kernels name the kind, and compilers drop the other kinds."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

FORMULA = 0
PLANE = 1
VOLUME = 2


@wp.struct
class Medium:
    kind: int
    formula: wp.array1d[float]
    plane: wp.array2d[float]
    volume: wp.array3d[float]
    corner: wp.vec4


@wp.func
def look_formula(formula: wp.array1d[float], at: wp.vec3):
    weighted = wp.vec3(formula[0] * at[0], formula[1] * at[1], formula[2] * at[2])
    s = wp.dot(weighted, at)
    above = formula[3] + s * (formula[4] + s * (formula[5] + s * formula[6]))
    below = formula[7] + s * (formula[8] + s * (formula[9] + s * formula[10]))
    up = formula[4] + s * (2.0 * formula[5] + 3.0 * s * formula[6])
    down = formula[8] + s * (2.0 * formula[9] + 3.0 * s * formula[10])
    square = above / below
    pull = (up - square * down) / below * weighted
    return wp.vec4(pull[0], pull[1], pull[2], square)


@wp.func
def weights_of(f: float):
    g = 1.0 - f
    return wp.vec4(g * g * g, 4.0 - 3.0 * f * f * (1.0 + g), 4.0 - 3.0 * g * g * (1.0 + f), f * f * f) / 6.0


@wp.func
def slopes_of(f: float):
    g = 1.0 - f
    return 0.5 * wp.vec4(-g * g, f * (3.0 * f - 4.0), g * (4.0 - 3.0 * g), f * f)


@wp.func
def cell_of(position: float, corners: int):
    return int(wp.clamp(position, 0.0, float(corners - 4)))


@wp.func
def into(position: float, cell: int):
    return wp.clamp(position - float(cell), -2.0, 3.0)


@wp.func
def look_plane(coefficients: wp.array2d[float], corner: wp.vec4, at: wp.vec3):
    x = (at[0] - corner[0]) * corner[3]
    y = (at[1] - corner[1]) * corner[3]
    i = cell_of(x, coefficients.shape[0])
    j = cell_of(y, coefficients.shape[1])
    wx = weights_of(into(x, i))
    dx = slopes_of(into(x, i))
    wy = weights_of(into(y, j))
    dy = slopes_of(into(y, j))
    result = wp.vec3(0.0, 0.0, 0.0)
    for a in range(4):
        row = wp.vec4(coefficients[i + a, j], coefficients[i + a, j + 1], coefficients[i + a, j + 2],
                      coefficients[i + a, j + 3])  # fmt: skip
        even = wp.dot(row, wy)
        result += wp.vec3(dx[a] * even, wx[a] * wp.dot(row, dy), wx[a] * even)
    scale = 0.5 * corner[3]
    return wp.vec4(scale * result[0], scale * result[1], 0.0, result[2])


@wp.func
def look_volume(coefficients: wp.array3d[float], corner: wp.vec4, at: wp.vec3):
    x = (at[0] - corner[0]) * corner[3]
    y = (at[1] - corner[1]) * corner[3]
    z = (at[2] - corner[2]) * corner[3]
    i = cell_of(x, coefficients.shape[0])
    j = cell_of(y, coefficients.shape[1])
    k = cell_of(z, coefficients.shape[2])
    wx = weights_of(into(x, i))
    dx = slopes_of(into(x, i))
    wy = weights_of(into(y, j))
    dy = slopes_of(into(y, j))
    wz = weights_of(into(z, k))
    dz = slopes_of(into(z, k))
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for a in range(4):
        for b in range(4):
            p = i + a
            q = j + b
            row = wp.vec4(coefficients[p, q, k], coefficients[p, q, k + 1], coefficients[p, q, k + 2],
                          coefficients[p, q, k + 3])  # fmt: skip
            even = wp.dot(row, wz)
            both = wx[a] * wy[b]
            result += wp.vec4(dx[a] * wy[b] * even, wx[a] * dy[b] * even, both * wp.dot(row, dz), both * even)
    scale = 0.5 * corner[3]
    return wp.vec4(scale * result[0], scale * result[1], scale * result[2], result[3])


@wp.func
def look(medium: Medium, at: wp.vec3):
    if medium.kind == FORMULA:
        return look_formula(medium.formula, at)
    if medium.kind == PLANE:
        return look_plane(medium.plane, medium.corner, at)
    return look_volume(medium.volume, medium.corner, at)
