"""Projection on rings: the effect of a turntable on light and dose is a product for each angular frequency."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Field, Fixed, Integer, Real, Table, Tiling, kernel

ROWS = 8
"""Number of neighboring rings, and of pairs of columns, that one item computes together."""

AT_ONCE = 2048
"""Greatest radix of a pass that is computed by further passes: on processors within their caches, on GPUs by a group in
local memory, of which OpenCL has 32 KiB everywhere."""
ONE_SUM = 20
"""Greatest radix of a pass that is a plain sum on all devices, if radices can be this small."""
FACTOR = 10
"""Greatest radix of a pass in registers, in OpenCL: for processors, and for the four factors that GPUs combine."""
AT_A_TIME = 32
"""Number of rings of a short transform that a group of a GPU processes together."""

Light = Annotated[np.ndarray, Field(("k", "r", "z"))]
"""At each frequency over the angles."""
LightOut = Annotated[np.ndarray, Field(("k", "r", "z"), writes=True)]
Source = Annotated[np.ndarray, Field(("a", "b", "z"))]
Sink = Annotated[np.ndarray, Field(("i", "j", "z"), writes=True)]
Spectrum = Annotated[np.ndarray, Field(("k", "cell", "z"))]
SpectrumOut = Annotated[np.ndarray, Field(("k", "cell", "z"), writes=True)]
RingBands = Annotated[np.ndarray, Table("int32", ("band", "16"))]
"""Rings with equal numbers of samples: first sample, samples per ring, rings, radix, product of the earlier radices,
first wave; for the source, then the sink: first position, n, and steps a and b: sample s of ring j is at first + (s mod
n)·a + (s div n)·b + j; and the additions of `in_groups`."""
Waves = Annotated[np.ndarray, Table("float32", ("wave", "2"))]  # cosine and sine of each n-th of a turn
Entries = Annotated[np.ndarray, Table("float32", ("entry",))]
"""For each frequency up to half of all, tile and pair of columns: real parts of `ROWS` cells, then the imaginary ones.
A column in the middle of mirrored ones, which is a pair with itself, has half of them; 0 beyond all columns."""
Tiles = Annotated[np.ndarray, Table("int32", ("tile", "2"))]
"""For each `ROWS` cells: first entry of a frequency, and the tile with conjugate entries."""
Lit = Annotated[np.ndarray, Table("int32", ("frequency", "tile"))]
"""Pairs of columns that light a tile at each frequency up to half of all, a multiple of `ROWS`."""
Order = Annotated[np.ndarray, Table("int32", ("frequency", "tile", "4"))]
"""For each frequency up to half of all, the tiles in decreasing order of the pairs of columns that light them: first
entry, number of these pairs, the tile, and the tile with conjugate entries."""


def factors(radix: int) -> tuple[int, int, int, int]:
    """First, second, third and last factor by which a group of a GPU computes a transform of a radix at once."""
    # The fewest factors of at most `FACTOR` each, of those the ones with the least sum, the greatest first; 1 for a
    # second or third that is not needed. Zeros if there are none, or for more samples than `AT_ONCE`.
    if radix > AT_ONCE:
        return (0, 0, 0, 0)
    for count in range(1, 5):
        found = [each for each in _products(radix, count, FACTOR) if 1 not in each or count == 1]
        if found:
            first, *more = min(found, key=lambda each: (sum(each), each))
            last = more.pop() if more else 1
            return (first, *[*more, 1, 1][:2], last)  # pyright: ignore[reportReturnType] - four of them
    return (0, 0, 0, 0)


def _products(n: int, count: int, most: int) -> list[tuple[int, ...]]:
    """This number of factors of n, of at most ``most`` each, in descending order."""
    if count == 1:
        return [(n,)] if n <= most else []
    own = [a for a in range(1, most + 1) if n % a == 0]
    return [(a, *rest) for a in own for rest in _products(n // a, count - 1, a)]


def is_even(band: tuple[int, ...]) -> bool:
    """Whether the inputs and outputs of a pass of a band are evenly spaced in their fields."""
    # Steps between neighbors do not exceed the n of their positions.
    _, n, _, radix, done, _, _, source, _, _, _, sink, _, _ = band
    read = n // radix % source == 0 or source >= n
    return read and (done % sink == 0 or sink % (done * radix) == 0 or sink >= n)


def in_groups(bands: list[tuple[int, ...]], *, whole: bool = False) -> np.ndarray:
    """`RingBands` from all its columns except the last two, which tell how groups of a GPU divide a pass."""
    # The last two: rings that a group processes at once (0 for direct sums, as for unevenly spaced samples), and the
    # band's first group. whole: whether a group computes one transform, of a radix of several factors.
    found, group = [], 0
    for band in bands:
        _, n, rings, radix, *_ = band
        few = radix <= FACTOR and is_even(band)
        at_once = 1 if whole else min(rings, AT_A_TIME) if few else 0
        found.append((*band, at_once, group))
        group += n // radix * -(-rings // (at_once or rings))
    return np.array(found)


def _paired(values: np.ndarray) -> np.ndarray:
    """Neighboring slices as complex numbers."""
    return values[..., 0::2] + 1j * values[..., 1::2]


def _parted(values: np.ndarray, out: np.ndarray) -> None:
    out[..., 0::2], out[..., 1::2] = np.real(values), np.imag(values)


def _right_and_left(columns: int, mirrored: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns of each pair, outward, or all of them and none; one in the middle mirrors itself."""
    if not mirrored:
        return np.arange(columns), np.arange(0)
    right = np.arange(columns // 2, columns)
    return right, columns - 1 - right


@kernel(
    over="sink",
    cpu=Tiling(major=1, minor=0),
    gpu=Tiling(major=4, minor=2, group=(192, 1), registers=80),
    constants={
        "cpu": {"OUTPUTS": 4, "AT_ONCE": AT_ONCE, "ONE_SUM": ONE_SUM, "FACTOR": FACTOR},
        "gpu": {"OUTPUTS": 5, "FACTOR": FACTOR, "HELD": 3072},
    },
)
def fourier(
    source: Source, bands: RingBands, waves: Waves, sign: Real, first: Fixed, second: Fixed, third: Fixed, last: Fixed,
    sink: Sink,
) -> None:  # fmt: skip
    """One pass of the Fourier transforms of rings over their samples, exponent ``sign``·i; the last one is in order."""
    # first … last: `factors` of the radix, if all bands have it, are `is_even`, and groups of a GPU compute it at once;
    # else 0. Source: T. G. Stockham, AFIPS Spring Joint Computer Conf. (1966) 229.
    slices = source.shape[2]
    given, found = _paired(source.reshape(-1, slices)), _paired(np.zeros((sink.shape[0] * sink.shape[1], slices)))
    for _, n, rings, radix, done, wave, *places in bands.tolist():
        (first, *read), (begin, *write) = places[:4], places[4:8]
        out, ring = np.arange(n), np.arange(rings)
        turns = n // (done * radix)
        step, start = out % (done * radix), out // (done * radix)
        total = 0.0
        for r in range(radix):
            c, s = waves[wave + r * step * turns % n].T
            sample = (start + r * turns) * done + step % done
            total = total + (c + 1j * sign * s)[:, None, None] * given[_place(first, read, sample, ring)]
        found[_place(begin, write, out, ring)] = total
    _parted(found.reshape(*sink.shape[:2], -1), sink)


def _place(first: int, steps: list[int], sample: np.ndarray, ring: np.ndarray) -> np.ndarray:
    n, a, b = steps
    return (first + sample % n * a + sample // n * b)[:, None] + ring


def most_lit_first(tiles: np.ndarray, lit: np.ndarray) -> np.ndarray:
    """`Order` of `Tiles` and `Lit`."""
    first, other = tiles.T
    order = np.argsort(-lit, axis=1, kind="stable")
    return np.stack([first[order], np.take_along_axis(lit, order, 1), order, other[order]], axis=2).astype(np.int32)


def _entries(entries: np.ndarray, tiles: np.ndarray, lit: np.ndarray, k: int, count: int) -> list[np.ndarray]:
    """Complex entries (pairs, `ROWS`) of each tile, at a frequency."""
    back, per = 2 * k > count, len(entries) // (count // 2 + 1)
    kept, found = count - k if back else k, []
    for tile in range(len(tiles)):
        own = int(tiles[tile, 1]) if back else tile
        start, pairs = kept * per + int(tiles[own, 0]), int(lit[kept, own])
        parts = entries[start : start + 2 * ROWS * pairs].reshape(pairs, 2, ROWS)
        found.append(parts[:, 0] + (-1j if back else 1j) * parts[:, 1])
    return found


@kernel(
    over="spectrum",
    cpu=Tiling(major=1, minor=ROWS),
    gpu=Tiling(major=1, minor=ROWS, group=(32, 1, 4)),
    nvidia=Tiling(major=2, minor=2 * ROWS, group=(64, 1, 2)),
    constants={"gpu": {"GROUP": 32, "SLABS": 4, "CHUNK": 8}, "nvidia": {"GROUP": 64, "SLABS": 2}},
)
def light_rings(
    light: Light, entries: Entries, greatest: Real, tiles: Tiles, lit: Lit, order: Order,
    mirrored: Integer, tf32: Integer, spectrum: SpectrumOut,
) -> None:  # fmt: skip
    """spectrum = entries · light: real parts use sums of columns that mirror each other, imaginary ones differences."""
    # If light is not mirrored (0), both use the columns themselves. Only matrix units use ``greatest`` (a bound on the
    # entries), ``order``, and ``tf32`` (whether numbers may be rounded to eleven bits).
    right, left = _right_and_left(light.shape[1], mirrored)
    for k, values in enumerate(_paired(light)):
        sums, differences = values[right], values[right]
        sums[: len(left)] += values[left]
        differences[: len(left)] -= values[left]
        for tile, parts in enumerate(_entries(entries, tiles, lit, k, len(light))):
            parts = parts[: len(right)]
            rings = np.real(parts).T @ sums[: len(parts)] + 1j * (np.imag(parts).T @ differences[: len(parts)])
            _parted(rings, spectrum[k, tile * ROWS : (tile + 1) * ROWS])


@kernel(
    over="light",
    cpu=Tiling(major=1, minor=ROWS),
    gpu=Tiling(major=1, minor=ROWS, slabs=2, group=(32, 1, 4)),
    nvidia=Tiling(major=2, minor=ROWS, group=(64, 1, 2)),
    constants={"gpu": {"GROUP": 32, "SLABS": 4}, "nvidia": {"GROUP": 64, "SLABS": 2}},
)
def gather_rings(
    spectrum: Spectrum, entries: Entries, greatest: Real, tiles: Tiles, lit: Lit, order: Order,
    mirrored: Integer, tf32: Integer, light: LightOut,
) -> None:  # fmt: skip
    """The transpose of `light_rings`."""
    right, left = _right_and_left(light.shape[1], mirrored)
    for k, rings in enumerate(_paired(spectrum)):
        sums, differences = np.zeros((2, len(right), rings.shape[1]), complex)
        for tile, parts in enumerate(_entries(entries, tiles, lit, k, len(spectrum))):
            parts, own = parts[: len(right)], rings[tile * ROWS : (tile + 1) * ROWS]
            sums[: len(parts)] += np.real(parts) @ own
            differences[: len(parts)] -= 1j * (np.imag(parts) @ own)
        total = np.zeros((light.shape[1], rings.shape[1]), complex)
        total[right] += sums + differences
        total[left] += (sums - differences)[: len(left)]
        _parted(total, light[k])
