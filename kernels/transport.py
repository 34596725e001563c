"""Diffusion and photochemistry of three species on a box of voxels, explicit in time."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Real, Table, Tiling, Volume, VolumeInOut, VolumeOut, kernel

Open = Annotated[np.ndarray, Table("uint8", ("x", "y"))]  # 1 where a column of voxels is resin, 0 where it is wall
Spread = Annotated[np.ndarray, Table("float32", ("3", "3"))]  # species, axis: D·Δt/d²
Walls = Annotated[np.ndarray, Table("float32", ("3", "6", "2"))]  # species, face: g0, g1 of the value beyond, g0 + g1·c
Rates = Annotated[np.ndarray, Table("float32", ("6",))]  # k_A·Δt, k_B·Δt, k_C·Δt, k_2·Δt, cross, Δt
Scratch = Annotated[np.ndarray, Table("float32", ("part", "room"), writes=True)]  # undefined afterwards
TINY = 1e-30
NOTHING = 1e-20


@kernel(
    over="a_out",
    reach="all",
    cpu=Tiling(major=32, minor=0, slabs=1 << 20),
    gpu=Tiling(major=8, minor=1, group=(128, 1)),
)
def transport(
    a: Volume, b: Volume, c: Volume, visible: Volume, ultraviolet: Volume, open: Open, spread: Spread, walls: Walls,
    rates: Rates, order: Integer, reacting: Integer, optical: Real, mechanical: Real, time: Real, steps: Integer,
    scratch: Scratch, a_out: VolumeOut, b_out: VolumeOut, c_out: VolumeOut, dose: VolumeInOut, optical_time: VolumeOut,
    mechanical_time: VolumeOut,
) -> None:  # fmt: skip
    """Advance A, B, C by ``steps`` of Δt in constant light; each species diffuses, then reacts where ``reacting``."""
    # Faces are x low, x high, y low, …; no flux passes between resin and wall. Radicals that are not inhibited add to
    # ``dose`` (light × time); its first crossings of ``optical`` and ``mechanical`` are recorded. Where an item has a
    # block of columns, it takes several steps in its cache, with ``scratch``; other devices take one step per launch.
    species = [np.array(s, dtype=float) for s in (a, b, c)]
    inside = np.asarray(open, bool)[..., None]
    for step in range(steps):
        species = [np.where(inside, _spread(s, inside, spread[k], walls[k]), s) for k, s in enumerate(species)]
        if reacting:
            reacted, more = _react(species, visible, ultraviolet, rates, order)
            species = [np.where(inside, after, before) for after, before in zip(reacted, species, strict=True)]
            more = np.where(inside, more, 0.0)
            for level, crossed in ((optical, optical_time), (mechanical, mechanical_time)):
                now = (dose < level) & (dose + more >= level)
                share = (level - dose[now]) / more[now]
                crossed[now] = time + (step + share) * rates[5]
            dose += more
    a_out[...], b_out[...], c_out[...] = species


def _spread(s: np.ndarray, inside: np.ndarray, spread: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """One explicit step of diffusion."""
    out = s.copy()
    for axis in range(3):
        here = np.moveaxis(s, axis, 0)
        passes = np.moveaxis(np.broadcast_to(inside, s.shape), axis, 0)
        (low0, low1), (high0, high1) = walls[2 * axis], walls[2 * axis + 1]
        between = np.diff(here, axis=0) * (passes[1:] & passes[:-1])
        gain = np.zeros_like(here)
        gain[:-1] += between
        gain[1:] -= between
        gain[0] += low0 + low1 * here[0] - here[0]
        gain[-1] += high0 + high1 * here[-1] - here[-1]
        np.moveaxis(out, axis, 0)[...] += spread[axis] * gain
    return out


def _react(
    species: list[np.ndarray], visible: np.ndarray, ultraviolet: np.ndarray, rates: np.ndarray, order: int
) -> tuple[list[np.ndarray], np.ndarray]:
    """One step of the reactions, and the dose of the radicals that met no inhibitor."""
    a, b, c = species
    light = visible + rates[4] * ultraviolet
    want_a, want_b = rates[0] * light, rates[1] * light
    whole = a + b
    share_a, share_b = (s / np.maximum(np.maximum(whole, want), TINY) for s, want in ((a, want_a), (b, want_b)))
    left = np.where(whole >= np.maximum(want_a, want_b), 0.0, np.maximum(0.0, 1.0 - share_a - share_b))
    a, b = _settled(a - want_a * share_a), _settled(b - want_b * share_b)
    split = rates[2] * ultraviolet
    split = np.minimum(c, c * split if order else split)
    paired = rates[3] * b * b / (1.0 + 2.0 * rates[3] * b)
    return [a, _settled(b + 2.0 * (split - paired)), c - split + paired], left * light * rates[5]


def _settled(value: np.ndarray) -> np.ndarray:
    """Values of at most `NOTHING`, including negative ones, become 0."""
    return np.where(value > NOTHING, value, 0.0)
