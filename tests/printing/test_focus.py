"""Depth bins: residual defocus, best planes, and frames that add up to the frame."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam
from vamgpu.printing.focus import FocusMasks, bins_needed, midline_depth, slots, split
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.placement import Placement

PAPER = Beam((1459, 4), 0.0144)
"""Light over the whole film, at 14.4 µm a column."""


def paper(bins: int = 3) -> FocusMasks:
    return FocusMasks.around(PAPER, 7.5, 3.0, bins)


def test_three_bins_keep_every_column_within_half_a_depth_of_focus() -> None:
    masks = paper()
    assert masks.midline == 9.0 and masks.depth(np.zeros(1))[0] == -9.0
    assert (masks.masks.sum(axis=0) == 1).all()
    assert masks.defocus.max() <= 1.9
    assert masks.defocus.max() == pytest.approx(1.5, abs=0.05)
    assert (masks.masks == masks.masks[:, ::-1]).all()


def test_a_column_goes_to_the_nearest_plane() -> None:
    masks = paper()
    away = np.abs(masks.depth(masks.x) - np.array(masks.planes)[:, None])
    chosen = (away * masks.masks).sum(axis=0)
    np.testing.assert_array_equal(chosen, away.min(axis=0))
    np.testing.assert_array_equal(chosen, masks.defocus)


def test_planes_are_the_best_there_are() -> None:
    beam = Beam((23, 1), 0.9)
    depth = np.unique(midline_depth(beam.columns(), 9.0))
    for bins in (1, 2, 3, 4):
        best = np.inf
        for cuts in combinations(range(1, depth.size), bins - 1):
            spans = [np.ptp(group) for group in np.split(depth, cuts)]
            best = min(best, 0.5 * max(spans))
        masks = FocusMasks.around(beam, 7.5, 3.0, bins)
        assert masks.bins == bins and masks.defocus.max() == pytest.approx(best, abs=1e-9)


def test_more_bins_never_blur_more_and_few_are_needed() -> None:
    worst = [paper(bins).defocus.max() for bins in range(1, 7)]
    assert (np.diff(worst) < 0).all()
    assert bins_needed(PAPER, 7.5, 3.0, 1.9) == 3
    assert bins_needed(PAPER, 7.5, 3.0, worst[4] * (1 + 1e-9)) == 5
    assert bins_needed(PAPER, 7.5, 3.0, worst[4] * (1 - 1e-6)) == 6


@pytest.mark.parametrize("bits", [8, 1])
@pytest.mark.parametrize("place", [Placement(), Placement(flip_r=True, shift=(2.25, -1.0))])
def test_binned_frames_add_up_to_the_frame(device: Device, bits: int, place: Placement) -> None:
    rng = np.random.default_rng(5)
    columns = 43
    pictures = rng.integers(0, 256 if bits == 8 else 2, (6, 5, columns), np.uint8)
    images = pictures if bits == 8 else np.packbits(pictures, axis=-1)
    frames = Frames.from_bytes(images, device, bits=bits, gray=GrayCurve.linear(), scale=2.0, columns=columns,
                               settings=place)  # fmt: skip
    masks = FocusMasks.around(Beam((columns, 5), 0.49), 7.5, 3.0, 3)
    binned = split(frames, masks)
    stack = np.array([part.images.numpy() for part in binned])
    assert len(binned) == 3 and all(part.device is frames.device for part in binned)
    np.testing.assert_array_equal(stack.sum(axis=0, dtype=np.uint8), images)
    np.testing.assert_array_equal(np.bitwise_or.reduce(stack), images)
    light = sum(part.irradiance("numpy").numpy() for part in binned)
    np.testing.assert_allclose(light, frames.irradiance("numpy").numpy(), rtol=0, atol=1e-12)


def test_what_lands_on_a_column_belongs_to_its_plane() -> None:
    """Flips and whole shifts undone, binned frames light exactly the beam's own masks."""
    columns = 43
    white = np.full((1, 3, columns), 255, np.uint8)
    masks = FocusMasks.around(Beam((columns, 3), 0.49), 7.5, 3.0, 3)
    for place in (Placement(shift=(3.0, 0.0)), Placement(flip_r=True, shift=(-2.0, 1.0)), Placement(flip_r=True)):
        frames = Frames.from_bytes(white, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=columns,
                                   settings=place)  # fmt: skip
        whole = frames.irradiance().numpy()
        for part, mask in zip(split(frames, masks), masks.masks, strict=True):
            np.testing.assert_array_equal(part.irradiance().numpy(), whole * mask[None, :, None])


def test_light_is_split_where_it_is(device: Device) -> None:
    rng = np.random.default_rng(6)
    light = rng.random((4, 43, 9)).astype(np.float32)
    masks = FocusMasks.around(Beam((43, 9), 0.49), 7.5, 3.0, 3)
    there = split(device.upload(light), masks)
    here = split(light, masks)
    for field, array, mask in zip(there, here, masks.masks, strict=True):
        np.testing.assert_array_equal(field.numpy().astype(np.float32), array)
        np.testing.assert_array_equal(array, light * mask[None, :, None])
    np.testing.assert_array_equal(sum(here), light)


def test_bytes_are_split_as_pictures() -> None:
    pictures = np.random.default_rng(7).integers(0, 256, (2, 9, 43), np.uint8)
    binned = split(pictures, FocusMasks.around(Beam((43, 9), 0.49), 7.5, 3.0, 3))
    assert all(part.dtype == np.uint8 for part in binned)
    np.testing.assert_array_equal(sum(binned), pictures)


def test_slots_turn_so_that_the_lens_moves_less() -> None:
    order = slots(4, 3)
    np.testing.assert_array_equal(order, [[0, 1, 2], [2, 1, 0]] * 2)
    moves = np.diff(order.ravel())
    assert np.count_nonzero(moves) == 4 * 2 and np.abs(moves).max() == 1
    straight = np.diff(slots(4, 3, turning=False).ravel())
    assert np.count_nonzero(straight) == 4 * 3 - 1 and np.abs(straight).max() == 2


def test_bad_input_is_refused_with_numbers() -> None:
    with pytest.raises(BadInput, match="bins is"):
        paper(0)
    with pytest.raises(BadInput, match="bins is 9, but the beam's 3 depths"):
        FocusMasks.around(Beam((5, 1), 1.0), 7.5, 3.0, 9)
    with pytest.raises(BadInput, match="rising"):
        FocusMasks(4, 0.1, 9.0, (-1.0, -2.0))
    with pytest.raises(BadInput, match="thickness"):
        FocusMasks.around(PAPER, 7.5, 0.0)
    with pytest.raises(ShapeMismatch, match="7 columns; expected 1459"):
        split(np.zeros((3, 7, 4)), paper())
    with pytest.raises(BadInput, match="three-dimensional"):
        split(np.zeros(3), paper())
    frames = Frames.from_bytes(np.zeros((1, 2, 5), np.uint8), "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0,
                               columns=5)  # fmt: skip
    with pytest.raises(ShapeMismatch, match="5 columns"):
        split(frames, paper())
