"""Photons that scatter in resin inside concentric faces, tallied on rings about the axis and along z."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Real, Table, Tiling, kernel

ROUNDS = 7
UNITS = 1 << 20
"""Whole numbers of the tally in a path of 1."""
WAYS = 1 << 10
"""Number of azimuths of a scattered photon; means over them equal those over the circle for waves of fewer periods."""
STEEP = 1e-4
"""Sine of a direction's angle to the axis below which its azimuth is taken as 0."""

Rays = Annotated[np.ndarray, Table("float32", ("column", "ray", "8"))]
"""Where each ray enters the resin, x and y, and its direction; the share 1 − exp(−extinction · length) of its photons
that collide; their weight; and 0. Light that is not refracted travels towards −x, with its columns along y."""
Faces = Annotated[np.ndarray, Table("float32", ("face", "4"))]
"""From the resin outward: radius, and refractive index inside and outside; 0."""
Rings = Annotated[np.ndarray, Table("int32", ("ring", "2"))]  # first cell, and number of cells
Lags = Annotated[np.ndarray, Table("int32", ("lag",))]
"""Bin of each distance along z [slices]. Paths farther away are not tallied."""
Cosines = Annotated[np.ndarray, Table("float32", ("quantile",))]
"""Cosine of the scattering angle at even quantiles from 0 to 1, linear in between."""
Ways = Annotated[np.ndarray, Table("float32", ("way", "2"))]  # cosine and sine of `WAYS` azimuths
CountOut = Annotated[np.ndarray, Table("uint32", ("item",), writes=True)]
Tally = Annotated[np.ndarray, Table("uint32", ("column", "cell", "bin", "2"), writes=True, updates=True)]
"""Path of a column's photons in each cell, in shares 1 / `UNITS`: its low and its high 32 bits."""

F = np.float32
ATAN = [F(c) for c in (0.15915132, -0.05293857, 0.03080291, -0.01852985, 0.00837909, -0.00186516)]


def philox(photon: np.ndarray, segment: int, seed: int) -> np.ndarray:
    """Four random numbers of 32 bits for each photon, (4, photons)."""
    low, high = np.uint64(0xFFFFFFFF), np.uint64(32)
    a, b, c, d = photon.astype(np.uint64), np.full(photon.shape, segment, np.uint64), *np.zeros((2, photon.size), "u8")
    for turn in range(ROUNDS):
        key, other = (np.uint64((start + turn * step) & 0xFFFFFFFF) for start, step in zip(
            (int(seed), 0), (0x9E3779B9, 0xBB67AE85), strict=True))  # fmt: skip
        first, second = a * np.uint64(0xD2511F53), c * np.uint64(0xCD9E8D57)
        a, b, c, d = (second >> high) ^ b ^ key, second & low, (first >> high) ^ d ^ other, first & low
    return np.stack([a, b, c, d]).astype(np.uint32)


def unit(bits: np.ndarray) -> np.ndarray:
    """Numbers between 0 and 1, from 23 bits."""
    return ((bits >> np.uint32(9)).astype(F) + F(0.5)) * F(2.0**-23)


def free_path(share: np.ndarray) -> np.ndarray:
    """−ln of a number from 0 to 1, by the series of the inverse hyperbolic tangent."""
    part, power = np.frexp(share)
    low = part < F(0.70710677)
    part, power = np.where(low, part * F(2.0), part), (low - power).astype(F)
    z = (part - F(1.0)) / (part + F(1.0))
    s = z * z
    series = F(1.0) + s * (F(0.33333334) + s * (F(0.2) + s * (F(0.14285715) + s * F(0.11111111))))
    return power * F(0.6931472) - F(2.0) * z * series


def turn_of(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Azimuth of a point, in turns from −1/2 to 1/2: a polynomial of the arc tangent in each octant, to 3e-7."""
    wide, high = np.abs(x), np.abs(y)
    z = np.minimum(wide, high) / np.maximum(np.maximum(wide, high), F(1e-30))
    s = z * z
    angle = z * (ATAN[0] + s * (ATAN[1] + s * (ATAN[2] + s * (ATAN[3] + s * (ATAN[4] + s * ATAN[5])))))
    angle = np.where(high > wide, F(0.25) - angle, angle)
    angle = np.where(x < 0, F(0.5) - angle, angle)
    return np.where(y < 0, -angle, angle)


def scattered(u: np.ndarray, bits: np.ndarray, way: np.ndarray, cosines: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Directions (3, photons) after a collision."""
    place = unit(bits) * F(cosines.size - 1)
    low = place.astype(np.int32)
    cosine = cosines[low] + (place - low.astype(F)) * (cosines[low + 1] - cosines[low])
    sine = np.sqrt(np.maximum(F(1.0) - cosine * cosine, F(0.0)))
    x, y, z = u
    flat = np.sqrt(x * x + y * y)
    steep, over = flat < F(STEEP), np.maximum(flat, F(STEEP))
    cx, cy = np.where(steep, F(1.0), x / over), np.where(steep, F(0.0), y / over)
    along, across = sine * ways[way, 0], sine * ways[way, 1]
    x, y, z = (
        (along * (cx * z) - across * cy) + x * cosine,
        (along * (cy * z) + across * cx) + y * cosine,
        z * cosine - along * flat,
    )
    length = np.sqrt((x * x + y * y) + z * z)
    return np.stack([x / length, y / length, z / length])


def to_face(p: np.ndarray, u: np.ndarray, layer: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Paths to the next face, and whether it is the inner one of a photon's layer."""
    (x, y, _), (ux, uy, _) = p, u
    a = np.maximum(ux * ux + uy * uy, F(1e-12))
    b, square = x * ux + y * uy, x * x + y * y
    radius = faces[np.maximum(layer - 1, 0), 0]
    inside = b * b - a * np.maximum(square - radius * radius, F(0.0))
    inward = (layer > 0) & (b < 0) & (inside > 0)
    radius = faces[layer, 0]
    outside = b * b + a * np.maximum(radius * radius - square, F(0.0))
    path = np.where(inward, -b - np.sqrt(np.maximum(inside, F(0.0))), np.sqrt(outside) - b) / a
    return np.maximum(path, F(0.0)), inward


def crossed(
    p: np.ndarray, u: np.ndarray, bits: np.ndarray, face: np.ndarray, inward: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Directions (3, photons) behind a face, and which photons pass it, by Fresnel's law for unpolarized light."""
    (x, y, _), (ux, uy, uz) = p, u
    radius = np.sqrt(x * x + y * y)
    nx, ny = x / radius, y / radius
    before, behind = np.where(inward, face[:, 2], face[:, 1]), np.where(inward, face[:, 1], face[:, 2])
    normal = ux * nx + uy * ny
    cosine, ratio = np.abs(normal), before / behind
    square = F(1.0) - ratio * ratio * np.maximum(F(1.0) - cosine * cosine, F(0.0))
    after = np.sqrt(np.maximum(square, F(0.0)))
    s = (before * cosine - behind * after) / (before * cosine + behind * after)
    q = (before * after - behind * cosine) / (before * after + behind * cosine)
    passes = (square > 0) & (unit(bits) >= F(0.5) * (s * s + q * q))
    bend = np.where(inward, ratio * cosine - after, after - ratio * cosine)
    scale, shift = np.where(passes, ratio, F(1.0)), np.where(passes, bend, F(-2.0) * normal)
    return np.stack([scale * ux + shift * nx, scale * uy + shift * ny, scale * uz]), passes


@kernel(over="absorbed", cpu=Tiling(minor=1))
def photons(
    rays: Rays, faces: Faces, rings: Rings, lags: Lags, cosines: Cosines, ways: Ways, extinction: Real, albedo: Real,
    per_ring: Real, per_slice: Real, first: Integer, each: Integer, most: Integer, seed: Integer, absorbed: CountOut,
    escaped: CountOut, tally: Tally,
) -> None:  # fmt: skip
    """Photons from number ``first`` on, ``each`` per item, through at most ``most`` segments each."""
    # extinction: collisions per length; albedo: share of them after the first one that scatter. per_ring, per_slice:
    # rings and slices in a length; per_slice is 0 for light that is the same at every height. A photon begins with its
    # first collision, at a random height in a slice. Two points, half a segment apart, stand for each segment in resin.
    rays, faces, cosines, ways = (np.asarray(table, F) for table in (rays, faces, cosines, ways))
    columns, count = rays.shape[:2]
    number = np.arange(absorbed.size * each)
    item, photon = number // each, number + first
    column, ray = photon % columns, photon // columns % count
    own, bits = rays[column, ray], philox(photon, 0, seed)
    t = free_path(F(1.0) - unit(bits[0]) * own[:, 5]) / F(extinction)
    u, weight, layer = own[:, 2:5].T, own[:, 6], np.zeros(photon.size, int)
    z = unit(bits[1]) - F(0.5)
    p = np.stack([own[:, 0] + u[0] * t, own[:, 1] + u[1] * t, z + u[2] * t * F(per_slice)])
    u = scattered(u, bits[2], bits[3] >> np.uint32(22), cosines, ways)
    absorbed[...], escaped[...] = 0, np.bincount(item[weight <= 0], minlength=escaped.size)
    low, high = np.moveaxis(tally.astype(np.uint64), -1, 0)
    sums, live = low + (high << np.uint64(32)), weight > 0
    for segment in range(1, most + 1):
        p, u, layer, weight, item, photon, column = (v[..., live] for v in (p, u, layer, weight, item, photon, column))
        if not photon.size:
            break
        bits = philox(photon, segment, seed)
        path, inward = to_face(p, u, layer, faces)
        free = free_path(unit(bits[0])) / F(extinction)
        collides, live = (layer == 0) & (free < path), np.ones(photon.size, bool)
        path = np.where(collides, free, path)
        for half in (F(0.0), F(0.5)):
            share = unit(bits[1]) * F(0.5) + half
            _add(sums, rings, lags, p, u, path * share, weight * path, (layer == 0, column, per_ring, per_slice))
        p = np.stack([p[0] + u[0] * path, p[1] + u[1] * path, p[2] + u[2] * path * F(per_slice)])
        stays = (bits[3] & np.uint32(0x3FFFFF)).astype(F) * F(2.0**-22) < F(albedo)
        at = layer - inward
        bent, passes = crossed(p, u, bits[2], faces[at], inward)
        turned = scattered(u, bits[2], bits[3] >> np.uint32(22), cosines, ways)
        u = np.where(collides, turned, bent)
        layer = layer + np.where(collides | ~passes, 0, np.where(inward, -1, 1))
        for counts, ends in ((absorbed, collides & ~stays), (escaped, layer == len(faces))):
            counts += np.bincount(item[ends], minlength=counts.size).astype(np.uint32)
            live &= ~ends
    tally[..., 0], tally[..., 1] = sums & np.uint64(0xFFFFFFFF), sums >> np.uint64(32)


def _add(
    sums: np.ndarray, rings: np.ndarray, lags: np.ndarray, p: np.ndarray, u: np.ndarray, t: np.ndarray,
    path: np.ndarray, where: tuple,
) -> None:  # fmt: skip
    """Add half of each path in the resin to the cell of the point at t."""
    counted, column, per_ring, per_slice = where
    x, y, z = p[0] + u[0] * t, p[1] + u[1] * t, p[2] + u[2] * t * F(per_slice)
    ring = (np.sqrt(x * x + y * y) * F(per_ring)).astype(np.int32)
    lag = np.abs(np.floor(np.clip(z, -1e6, 1e6) + F(0.5)).astype(np.int32))
    some = counted & (ring < len(rings)) & (lag < lags.size)
    ring, lag = ring[some], lag[some]
    cells = rings[ring, 1]
    place = np.floor(turn_of(x[some], y[some]) * cells.astype(F) + F(0.5)).astype(np.int32)
    place = rings[ring, 0] + np.where(place < 0, place + cells, place) % cells
    value = (np.minimum(path[some] * F(0.5 * UNITS), F(4e9)) + F(0.5)).astype(np.uint64)
    np.add.at(sums, (column[some], place, lags[lag]), value)
