"""Bit planes of frames wider than eight blocks, where processors write whole lines of the cache, and their sums."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.kernels.planes import pick_frames, split_planes, strips_for, strips_of

RNG = np.random.default_rng(3)


def split(device: Device, lines: int, columns: int, rows: int, width: int, left: int, strips: int) -> tuple:
    """Planes and sums of four frames, of which one is white: sums must not overflow."""
    images = np.random.default_rng(columns).integers(0, 256, (4, lines, columns), dtype=np.uint8)
    images[0] = 255
    masks = np.random.default_rng(left).integers(0, 256, (2, columns), dtype=np.uint8)
    masks[0] = 255
    packed = device.upload(np.full((4, 8, rows, width), 77, np.uint8), table=True)
    sent = device.upload(np.full((4, strips), -5, np.int32), table=True)
    chosen = device.upload(np.array([[0, 0], [3, 1], [2, 0], [1, 1]], np.int32), table=True)
    tables = {"images": device.upload(images, table=True), "masks": device.upload(masks, table=True)}
    device.launch(split_planes, **tables, chosen=chosen, top=rows - lines, left=left, packed=packed, sent=sent)
    return packed.numpy(), sent.numpy()


@cache
def defined(*sizes: int) -> tuple:
    return split(vamgpu.open_device("numpy"), *sizes)


@pytest.mark.parametrize(
    ("lines", "columns", "rows", "width", "left", "strips"),
    [
        (16, 1920, 16, 240, 0, 16),  # the lines of a plane do not begin where those of the cache do
        (9, 1100, 12, 256, 70, 5),
        (9, 1100, 12, 256, 64, 96),  # columns of blocks, in bands of four rows
        (5, 1023, 7, 136, 33, 2),  # planes that begin in the middle of a line of the cache
        (40, 1024, 40, 128, 0, 1),  # one strip: 160 times 64 white columns in a row, twice
        (3, 2, 3, 8, 61, 9),
    ],
)
def test_planes_and_sums(
    fast_device: Device, lines: int, columns: int, rows: int, width: int, left: int, strips: int
) -> None:
    wanted = defined(lines, columns, rows, width, left, strips)
    got = split(fast_device, lines, columns, rows, width, left, strips)
    assert np.array_equal(got[0], wanted[0])
    assert np.array_equal(got[1], wanted[1])
    assert wanted[1][0].sum() == 255 * lines * columns


@pytest.mark.parametrize("gpu", [False, True])
@pytest.mark.parametrize(("rows", "width"), [(1080, 240), (1080, 256), (7, 8), (1, 64), (1600, 320)])
def test_strips_share_out_every_block_in_order(rows: int, width: int, gpu: bool) -> None:
    strips = strips_for(rows, width, gpu)
    found = strips_of(rows, width, strips)
    assert found.shape == (rows, width // 8) and found.min() == 0 and found.max() < strips
    counts = np.bincount(found.ravel())
    assert counts[:-1].max(initial=1) <= -(-rows * (width // 8) // strips) + 7
    if gpu and rows > 8:  # neighbors take neighboring blocks
        assert np.array_equal(found[0], np.arange(width // 8))
    else:
        assert (np.diff(found.ravel()) >= 0).all()


def picked(device: Device, own: tuple[int, int], size: tuple[int, int], top: int, left: int) -> np.ndarray:
    rng = np.random.default_rng(own)
    images, masks = rng.integers(0, 256, (3, *own), np.uint8), rng.integers(0, 256, (2, own[1]), np.uint8)
    tables = {"images": images, "masks": masks}
    tables |= {"chosen": np.array([[2, 0], [0, 1]], np.int32), "picked": np.full((2, *size), 77, np.uint8)}
    held = {name: device.upload(table, table=True) for name, table in tables.items()}
    device.launch(pick_frames, **held, top=top, left=left)
    return held["picked"].numpy()


@pytest.mark.parametrize("own", [(5, 7), (1, 1), (9, 40)])
@pytest.mark.parametrize("size", [(5, 7), (12, 50), (3, 4), (4, 0)])
def test_frames_are_picked_into_any_place(fast_device: Device, own: tuple[int, int], size: tuple[int, int]) -> None:
    for top, left in ((0, 0), (2, 3), (0, size[1]), (size[0] + 1, size[1] + 9)):
        wanted = picked(vamgpu.open_device("numpy"), own, size, top, left)
        assert np.array_equal(picked(fast_device, own, size, top, left), wanted), (top, left)
