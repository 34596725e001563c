"""Projection on rings: what a turntable does to light and dose is a product for each angular frequency.

At even angles the light of one pose, turned, is the light of all poses. On rings of even angular samples the dose is
therefore a convolution over the angle: a Fourier transform of the light over poses, for each frequency a product with
what one pose leaves on the rings, and the transform back. Two neighboring slices are the real and the imaginary part of
one complex number; the convolution is real, so they never mix. Slices are even in number.

A volume is ``[turn, ring cell, z]``: a ring that has m samples a turn has m of the cells, and sample t·m + q of it lies
at turn t and cell ``begin + q · rings of its belt + ring``. Its spectrum is ``[frequency, ring cell, z]``, where
frequency k + j·turns lies at k and cell ``begin + j · rings of its belt + ring``.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Field, Integer, Real, Table, Tiling, kernel

ROWS = 8
"""Neighboring rings, and pairs of columns, that one item computes together."""

AT_ONCE = 2048
"""Greatest radix of a pass that processors compute by passes of their own, within their caches."""
ONE_SUM = 20
"""Greatest radix of a pass that is a plain sum everywhere, where radices can be so small."""
FACTOR = 10
"""Greatest radix of a pass in registers, in OpenCL: a processor's own, and of two that GPUs make one of."""

Light = Annotated[np.ndarray, Field(("k", "r", "z"))]
LightOut = Annotated[np.ndarray, Field(("k", "r", "z"), writes=True)]
Source = Annotated[np.ndarray, Field(("a", "b", "z"))]
Sink = Annotated[np.ndarray, Field(("i", "j", "z"), writes=True)]
Folded = Annotated[np.ndarray, Field(("k", "pair", "z"))]
FoldedOut = Annotated[np.ndarray, Field(("k", "pair", "z"), writes=True)]
Spectrum = Annotated[np.ndarray, Field(("k", "cell", "z"))]
SpectrumOut = Annotated[np.ndarray, Field(("k", "cell", "z"), writes=True)]
Belts = Annotated[np.ndarray, Table("int32", ("belt", "17"))]
"""Rings of equally many samples: first sample, samples a ring, rings, radix, product of the radices before, first
wave; for the source, then the sink: first place, n, and steps a and b: sample s of ring j lies at
first + (s mod n)·a + (s div n)·b + j; and what `in_groups` adds."""
Waves = Annotated[np.ndarray, Table("float32", ("wave", "2"))]  # cosine and sine of each n-th of a turn
Entries = Annotated[np.ndarray, Table("float32", ("entry",))]
"""For each frequency up to half of all, tile and pair of columns: real parts of `ROWS` cells, then the imaginary."""
Tiles = Annotated[np.ndarray, Table("int32", ("tile", "5"))]
"""Of each `ROWS` cells: first entry, pairs of columns that light them, the tile whose entries are conjugate, and the
frequencies, up to half of all, from which to before which no entry counts."""
Order = Annotated[np.ndarray, Table("int32", ("frequency", "tile", "4"))]
"""For each frequency up to half of all, the tiles, those first that most pairs of columns light: first entry, pairs of
columns that light them there, the tile, and that whose entries are conjugate."""


def greater_factor(radix: int) -> int:
    """Of two factors of a radix the greater, both of at most `FACTOR`; 0 where there are no such two."""
    return next((a for a in range(1, FACTOR + 1) if a * a >= radix and radix % a == 0), 0)


def in_groups(belts: list[tuple[int, ...]]) -> np.ndarray:
    """`Belts`: the columns of a pass, and how groups of a GPU share them out.

    Args:
        belts: Of each belt all columns but the last three.

    Returns:
        The whole table. Its last columns: the greater of two small factors of the radix, 0 where direct sums are to be
        taken; how many rings a group takes at once; the belt's first group.
    """
    found, group = [], 0
    for belt in belts:
        _, n, rings, radix, *_ = belt
        factor = greater_factor(radix)
        batches = -(-rings // max(fourier.constants["gpu"]["HELD"] // radix, 1)) if factor else 1
        found.append((*belt, factor, -(-rings // batches), group))
        group += n // radix * batches
    return np.array(found)


def _paired(values: np.ndarray) -> np.ndarray:
    """Neighboring slices as complex numbers."""
    return values[..., 0::2] + 1j * values[..., 1::2]


def _parted(values: np.ndarray, out: np.ndarray) -> None:
    out[..., 0::2], out[..., 1::2] = np.real(values), np.imag(values)


def _mirrored(columns: int, pairs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns right and left of the middle of each pair, and how many there are: 2, 1 in the middle, 0 beyond."""
    right = columns // 2 + np.arange(pairs)
    left = columns - 1 - right
    return right, left, np.where(right < columns, 2 - (right == left), 0)


@kernel(over="folded", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1))
def fold_columns(sinogram: Light, mirrored: Integer, folded: FoldedOut) -> None:
    """Sums of columns that mirror each other, then right minus left; zero beyond the columns.

    Where light is not mirrored (0), columns are copied.
    """
    folded[...] = 0.0
    columns, half = sinogram.shape[1], folded.shape[1] // 2
    if not mirrored:
        folded[:, :columns] = sinogram
        return
    right, left, count = _mirrored(columns, half)
    two, one = np.flatnonzero(count == 2), np.flatnonzero(count == 1)
    folded[:, two] = sinogram[:, right[two]] + sinogram[:, left[two]]
    folded[:, half + two] = sinogram[:, right[two]] - sinogram[:, left[two]]
    folded[:, one] = sinogram[:, right[one]]


@kernel(over="sinogram", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1))
def unfold_columns(folded: Folded, mirrored: Integer, sinogram: LightOut) -> None:
    """The transpose of `fold_columns`."""
    columns, half = sinogram.shape[1], folded.shape[1] // 2
    if not mirrored:
        sinogram[...] = folded[:, :columns]
        return
    right, left, count = _mirrored(columns, half)
    two, one = np.flatnonzero(count == 2), np.flatnonzero(count == 1)
    sinogram[:, right[two]] = folded[:, two] + folded[:, half + two]
    sinogram[:, left[two]] = folded[:, two] - folded[:, half + two]
    sinogram[:, right[one]] = folded[:, one]


@kernel(
    over="sink",
    cpu=Tiling(major=1, minor=0),
    gpu=Tiling(major=1, minor=2, group=(128, 1), registers=80),
    constants={
        "cpu": {"OUTPUTS": 4, "AT_ONCE": AT_ONCE, "ONE_SUM": ONE_SUM, "FACTOR": FACTOR},
        "gpu": {"OUTPUTS": 5, "FACTOR": FACTOR, "HELD": 192},
    },
)
def fourier(source: Source, belts: Belts, waves: Waves, sign: Real, sink: Sink) -> None:
    """One pass of the Fourier transforms of rings over their samples, of exponent ``sign``·i; in order after the last.

    Source: T. G. Stockham, AFIPS Spring Joint Computer Conf. (1966) 229.
    """
    slices = source.shape[2]
    given, found = _paired(source.reshape(-1, slices)), _paired(np.zeros((sink.shape[0] * sink.shape[1], slices)))
    for _, n, rings, radix, done, wave, *places in belts.tolist():
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


def most_lit_first(tiles: np.ndarray, count: int) -> np.ndarray:
    """`Order` of `Tiles` at so many frequencies."""
    k = np.arange(count // 2 + 1)[:, None]
    first, pairs, other, dark, lit = tiles.T
    given = np.where((k >= dark) & (k < lit), 0, pairs)
    order = np.argsort(-given, axis=1, kind="stable")
    return np.stack([first[order], np.take_along_axis(given, order, 1), order, other[order]], axis=2).astype(np.int32)


def _entries(entries: np.ndarray, tiles: np.ndarray, k: int, count: int) -> list[np.ndarray]:
    """Of a frequency: entries (pairs, `ROWS`) of each tile, complex."""
    back, per = 2 * k > count, len(entries) // (count // 2 + 1)
    found = []
    for tile in range(len(tiles)):
        first, pairs, _, dark, lit = (int(n) for n in tiles[int(tiles[tile, 2]) if back else tile])
        kept = count - k if back else k
        pairs *= not dark <= kept < lit
        start = kept * per + first
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
    folded: Folded, entries: Entries, greatest: Real, tiles: Tiles, order: Order, mirrored: Integer,
    tf32: Integer, spectrum: SpectrumOut,
) -> None:  # fmt: skip
    """spectrum = entries · light: real parts take sums of columns that mirror each other, imaginary ones differences.

    Where light is not mirrored (0), both take the columns themselves. For matrix units alone are greatest, than which
    no entry is; order; and tf32: numbers may lose what is beyond eleven bits of them.
    """
    half = folded.shape[1] // 2 if mirrored else 0
    for k, light in enumerate(_paired(folded)):
        for tile, parts in enumerate(_entries(entries, tiles, k, len(folded))):
            pairs = len(parts)
            rings = np.real(parts).T @ light[:pairs] + 1j * (np.imag(parts).T @ light[half : half + pairs])
            _parted(rings, spectrum[k, tile * ROWS : (tile + 1) * ROWS])


@kernel(
    over="folded",
    cpu=Tiling(major=1, minor=ROWS),
    gpu=Tiling(major=1, minor=ROWS, slabs=2, group=(32, 1, 4)),
    nvidia=Tiling(major=2, minor=ROWS, group=(64, 1, 2)),
    constants={"gpu": {"GROUP": 32, "SLABS": 4}, "nvidia": {"GROUP": 64, "SLABS": 2}},
)
def gather_rings(
    spectrum: Spectrum, entries: Entries, greatest: Real, tiles: Tiles, order: Order, mirrored: Integer,
    tf32: Integer, folded: FoldedOut,
) -> None:  # fmt: skip
    """The transpose of `light_rings`."""
    half = folded.shape[1] // 2 if mirrored else 0
    for k, rings in enumerate(_paired(spectrum)):
        total = np.zeros((folded.shape[1], rings.shape[1]), complex)
        for tile, parts in enumerate(_entries(entries, tiles, k, len(spectrum))):
            pairs, own = len(parts), rings[tile * ROWS : (tile + 1) * ROWS]
            total[:pairs] += np.real(parts) @ own
            total[half : half + pairs] -= 1j * (np.imag(parts) @ own)
        _parted(total, folded[k])
