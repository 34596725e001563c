"""A cuvette as a box of resin between two glass plates, in which single photons are followed in float64.

Shares nothing with `vamgpu.optics.cuvette`: faces of the plates are crossed one by one, photons are absorbed at random,
and random numbers come from NumPy's own generator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

RESIN, GLASS, WALL, WIDTH, HEIGHT = 1.48, 1.52, 1.25, 10.0, 40.0
BEAM, SCREEN, PIXEL, HOLE, SIZE = 1.0, 25.0, 0.25, 6.0, 256
ACCEPTANCE, PORT = 0.0087, 8.0
INDEX = np.array([1.0, GLASS, RESIN, GLASS, 1.0])
OFF = np.array([5.3, -3.7])
"""Where the beam meets the paper, from the middle of the image [pixels]: column, row."""


@dataclass(frozen=True)
class Liquid:
    scattering: float
    g: float
    absorption: float


def passed(cosine: np.ndarray, before: Any, behind: Any, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Which photons pass a face, and the cosine behind it."""
    square = 1.0 - (before / behind) ** 2 * (1.0 - cosine**2)
    after = np.sqrt(np.maximum(square, 0.0))
    s = ((before * cosine - behind * after) / (before * cosine + behind * after)) ** 2
    p = ((before * after - behind * cosine) / (before * after + behind * cosine)) ** 2
    return rng.random(cosine.size) >= np.where(square < 0.0, 1.0, 0.5 * (s + p)), after


def scattered(v: np.ndarray, g: float, rng: np.random.Generator) -> np.ndarray:
    """Directions (photons, 3) after a collision, by the formula of Henyey and Greenstein."""
    share, turn = rng.random(len(v)), 2.0 * np.pi * rng.random(len(v))
    cosine = (1.0 + g * g - ((1.0 - g * g) / (1.0 - g + 2.0 * g * share)) ** 2) / (2.0 * g)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    one = np.cross(v, np.where(np.abs(v[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    across = np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * np.cross(v, one)
    found = cosine[:, None] * v + sine[:, None] * across
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def through(
    length: float, liquid: Liquid, photons: int, rng: np.random.Generator, index: np.ndarray = INDEX
) -> tuple[np.ndarray, np.ndarray]:
    """Places and directions of the photons that leave by the far plate, (photons, 3)."""
    faces = np.array([-WALL, 0.0, length, length + WALL])
    radius, turn = 0.5 * BEAM * np.sqrt(rng.random(photons)), 2.0 * np.pi * rng.random(photons)
    p = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(photons, -WALL)], axis=1)
    d, layer, ends = np.tile([0.0, 0.0, 1.0], (photons, 1)), np.zeros(photons, int), []
    while len(p):
        up, rate = d[:, 2] > 0, liquid.scattering + liquid.absorption
        with np.errstate(divide="ignore", invalid="ignore"):
            to_face = (faces[np.where(up, layer, layer - 1)] - p[:, 2]) / d[:, 2]
            to_sides = (0.5 * np.array([WIDTH, HEIGHT]) - np.sign(d[:, :2]) * p[:, :2]) / np.abs(d[:, :2])
        free = np.where(layer == 2, rng.exponential(1.0 / rate, len(p)), np.inf)
        side = np.fmin(to_sides[:, 0], to_sides[:, 1])
        step = np.fmin(np.fmin(free, to_face), side)
        p = p + d * step[:, None]
        dead = (side <= np.fmin(free, to_face)) | ((step == free) & (rng.random(len(p)) * rate < liquid.absorption))
        hit = (step == free) & ~dead
        d[hit] = scattered(d[hit], liquid.g, rng)
        at = np.flatnonzero(~hit & ~dead)
        before, behind = layer[at], layer[at] + np.where(up[at], 1, -1)
        ok, cosine = passed(np.abs(d[at, 2]), index[before], index[behind], rng)
        d[at, :2] *= np.where(ok, index[before] / index[behind], 1.0)[:, None]
        d[at, 2] = np.where(ok, np.where(up[at], cosine, -cosine), -d[at, 2])
        layer[at] = np.where(ok, behind, before)
        out = layer == 4
        ends.append((p[out], d[out]))
        live = ~(dead | out | ((layer == 0) & (d[:, 2] < 0)))
        p, d, layer = p[live], d[live], layer[live]
    place, direction = (np.concatenate(each) for each in zip(*ends, strict=True))
    return place, direction


def measured(length: float, liquid: Liquid, photons: int, rng: np.random.Generator) -> dict[str, Any]:
    """Collimated and total light with an error of 1 %, and a noisy image of the paper in gray levels."""
    p, d = through(length, liquid, photons, rng)
    shares = {
        "collimated": (np.arccos(np.minimum(d[:, 2], 1.0)) < ACCEPTANCE).sum() / photons,
        "total": (np.hypot(p[:, 0], p[:, 1]) < 0.5 * PORT).sum() / photons,
    }
    place = (p[:, :2] + SCREEN * d[:, :2] / d[:, 2:]) / PIXEL + 0.5 * (SIZE - 1) + OFF
    count = np.histogram2d(place[:, 1], place[:, 0], bins=2 * [np.arange(SIZE + 1) - 0.5])[0]
    y, x = np.indices(count.shape)
    paper = np.hypot(x - 0.5 * (SIZE - 1) - OFF[0], y - 0.5 * (SIZE - 1) - OFF[1]) * PIXEL > 0.5 * HOLE
    light = count * paper * 20.0 + 100.0 + rng.normal(0.0, 3.0, count.shape)
    image = np.clip(np.rint(light), 0, 65535).astype(np.uint16)
    return {name: share * (1.0 + 0.01 * rng.normal()) for name, share in shares.items()} | {"image": image}
