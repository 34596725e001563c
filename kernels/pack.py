"""Light to frames and back: count values, choose gray levels, fold bits, and compute the light of the mirrors."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Real, Sinogram, SinogramOut, Table, Tiling, kernel

BINS = 1024
NEVER = 1e30
START_R, START_Z = 0.7548776662466927, 0.5698402909980532
"""Powers of the inverse plastic number: their multiples fill the unit square evenly (M. Roberts' R2 sequence)."""

Images = Annotated[np.ndarray, Table("uint8", ("angle", "z", "r"))]
ImagesOut = Annotated[np.ndarray, Table("uint8", ("angle", "z", "r"), writes=True)]
Bytes = Annotated[np.ndarray, Table("uint8", ("angle", "z", "byte"))]
BytesOut = Annotated[np.ndarray, Table("uint8", ("angle", "z", "byte"), writes=True)]
Flat = Annotated[np.ndarray, Table("float32", ("flat_row", "flat_column"))]  # one by one if the field is flat
Curve = Annotated[np.ndarray, Table("float32", ("level",))]
Bounds = Annotated[np.ndarray, Table("float32", ("256",))]
Counts = Annotated[np.ndarray, Table("int32", ("1024",), writes=True, updates=True)]


def tap(light: np.ndarray, across: int, up: int) -> np.ndarray:
    """out[a, r, z] = light[a, r + across, z + up], zero beyond the edges."""
    out = np.zeros_like(light)
    _, n_r, n_z = light.shape
    r, z = slice(max(0, -across), min(n_r, n_r - across)), slice(max(0, -up), min(n_z, n_z - up))
    if r.start < r.stop and z.start < z.stop:
        out[:, r, z] = light[:, r.start + across : r.stop + across, z.start + up : z.stop + up]
    return out


def moved(light: np.ndarray, across: tuple[int, float], up: tuple[int, float], side: int) -> np.ndarray:
    """``light`` moved by (shift, part) along r and z, towards larger (side −1) or smaller (side +1) indices."""
    (shift_r, part_r), (shift_z, part_z) = across, up
    total = np.zeros(light.shape)
    for more_r, weight_r in ((0, 1.0 - part_r), (1, part_r)):
        for more_z, weight_z in ((0, 1.0 - part_z), (1, part_z)):
            if weight_r * weight_z > 0:
                total += weight_r * weight_z * tap(light, side * (shift_r + more_r), side * (shift_z + more_z))
    return total


def frames(light: np.ndarray, flip_r: int, flip_z: int) -> np.ndarray:
    """Light [angle, r, z] as frames [angle, row, column]."""
    return light.transpose(0, 2, 1)[:, :: 1 if flip_z else -1, :: -1 if flip_r else 1]


def upright(frames: np.ndarray, flip_r: int, flip_z: int) -> np.ndarray:
    """Frames [angle, row, column] as light [angle, r, z]."""
    return frames[:, :: 1 if flip_z else -1, :: -1 if flip_r else 1].transpose(0, 2, 1)


@kernel(over="sinogram", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=0, minor=1))
def count_light(
    sinogram: Sinogram, flat: Flat, shift_r: Integer, shift_z: Integer, part_r: Real, part_z: Real, flip_r: Integer,
    flip_z: Integer, drop: Integer, prefix: Integer, counts: Counts,
) -> None:  # fmt: skip
    """counts[b] += frame pixels whose light, as the bits of a float32, starts with prefix followed by b."""
    # drop: number of bits to the right of b's ten. Positive floats sort like their bits; three rounds find a quantile
    # to its last bit. Dark pixels are left out; values that are not finite are in bins 1020 to 1023 of round one.
    required = frames(moved(sinogram, (shift_r, part_r), (shift_z, part_z), -1), flip_r, flip_z) / flat
    with np.errstate(over="ignore"):
        bits = np.abs(required[~(required <= 0)]).astype(np.float32).view(np.uint32)
    bits = bits[bits >> (drop + 10) == prefix]
    counts += np.bincount((bits >> drop) & (BINS - 1), minlength=BINS).astype(counts.dtype)


@kernel(over="sinogram", reach="all", cpu=Tiling(major=0, minor=16), gpu=Tiling(major=0, minor=1))
def quantize(
    sinogram: Sinogram, flat: Flat, curve: Curve, bounds: Bounds, gain: Real, shift_r: Integer, shift_z: Integer,
    part_r: Real, part_z: Real, flip_r: Integer, flip_z: Integer, carry: Real, images: ImagesOut,
) -> None:  # fmt: skip
    """images = the level whose light ``curve[level]`` is nearest to gain · light / flat."""
    # bounds: midway between each level and the next; `NEVER` after the last. carry: 0 rounds; the largest step between
    # levels makes the next angle compensate a pixel's error, because dose is a sum over angles. Neighbors start with
    # different errors and do not flash in step. Light that cannot be shown is not compensated.
    required = frames(moved(sinogram, (shift_r, part_r), (shift_z, part_z), -1), flip_r, flip_z) * gain / flat
    required = np.clip(required, curve[0], curve[-1])
    rows, columns = np.meshgrid(*(np.arange(n) for n in images.shape[1:]), indexing="ij")
    error = carry * ((rows * START_Z + columns * START_R) % 1.0 - 0.5)
    for frame, light in zip(images, required, strict=True):
        frame[...] = np.searchsorted(bounds, light + error, side="left")
        if carry > 0:
            error = light + error - curve[frame]


@kernel(over="folded")
def fold_bits(images: Images, folded: BytesOut) -> None:
    """Eight columns of 0 and 1 per byte, the leftmost in the highest bit; columns beyond the last are 0."""
    folded[...] = np.packbits(images, axis=-1)


@kernel(over="light", reach="all", cpu=Tiling(major=1, minor=0))
def unpack(
    images: Bytes, flat: Flat, curve: Curve, bits: Integer, scale: Real, shift_r: Integer, shift_z: Integer,
    part_r: Real, part_z: Real, flip_r: Integer, flip_z: Integer, light: SinogramOut,
) -> None:  # fmt: skip
    """light = scale · flat · curve[level], moved back from where the frame's flips and shift put it."""
    # bits: 8 if a byte is a level, 1 if it holds eight columns.
    levels = images if bits == 8 else np.unpackbits(images, axis=-1, count=light.shape[1])
    shown = upright(scale * flat * curve[levels], flip_r, flip_z)
    light[...] = moved(shown, (shift_r, part_r), (shift_z, part_z), 1)
