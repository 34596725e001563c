"""A camera of any size and orientation: its images on the beam's pixels, with the noise that they then have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.live import SensorNoise
from vamgpu.live.sensor import BeamImages, SensorView
from vamgpu.printing.placement import Placement

PIXELS = 40, 24
"""Columns and rows of the beam."""
SHAPE = 480, 640
MIRRORS = 60, 90


def scene(rows: int, columns: int, parts: int) -> np.ndarray:
    """Light without symmetry, smooth over a pixel of the beam, [row, column] of its parts."""
    z, r = ((np.arange(n * parts) + 0.5) / parts / n for n in (rows, columns))
    return 0.5 + 0.3 * np.sin(5.0 * r) * z[:, None] + 0.2 * z[:, None] ** 2


@pytest.mark.parametrize("rotation", [0, 90, 180, 270])
@pytest.mark.parametrize("flip", [False, True])
def test_images_come_back_on_the_beam_whichever_way_the_camera_looks(rotation: int, flip: bool) -> None:
    view = SensorView.described(SHAPE, MIRRORS, 6.0, flip=flip, rotation=rotation, dark=20.0, bits=12)
    upright = np.arange(12.0).reshape(3, 4)
    turned = np.rot90(upright[:, ::-1] if flip else upright, -(rotation // 90))
    small = SensorView.described(turned.shape, upright.shape, 1.0, flip=flip, rotation=rotation)  # type: ignore[arg-type]
    assert np.array_equal(small.shown(upright), turned)
    beam = view.of_beam(Placement(shift=(1.25, -0.5)), PIXELS, (18, 25))
    images = BeamImages(beam, PIXELS)
    seen = images(np.rint(20.0 + 3000.0 * beam.finer(8).shown(scene(24, 40, 8)))) / images.scale
    inner = slice(3, -3), slice(3, -3)
    assert np.abs(seen - 3000.0 * scene(24, 40, 1))[inner].max() < 12.0
    assert f"turned by {rotation if rotation < 270 else -90}" in view.orientation.replace("-180", "180")
    assert ("mirrored" in view.orientation) is flip


def test_a_pixel_of_the_beam_is_where_the_frames_show_it() -> None:
    mirrors = SensorView((60, 90), ((1.0, 0.0), (0.0, 1.0)), (0.0, 0.0))
    frame = np.zeros((24, 40))
    frame[2, 5] = 1.0  # row 0 of frames shows the largest z
    whole = np.zeros((60, 90))
    whole[18:42, 25:65] = frame
    for settings, place in (
        (Placement(), (21, 5)), (Placement(flip_z=True), (2, 5)), (Placement(flip_r=True), (21, 34)),
        (Placement(shift=(3.0, 2.0)), (19, 2)),
    ):  # fmt: skip
        seen = BeamImages(mirrors.of_beam(settings, PIXELS, (18, 25)), PIXELS)(200.0 * whole)
        assert np.unravel_index(int(np.nanargmax(seen)), seen.shape) == place


def test_the_noise_of_a_resampled_image_is_what_it_says() -> None:
    view = SensorView.described(SHAPE, (24, 40), 7.3, rotation=90, dark=8.0, bits=12)
    images, noise = BeamImages(view, PIXELS), SensorNoise(2.0, 0.1, 12)
    told = images.noise(noise)
    level = 900.0 * np.ones(SHAPE)
    random = np.random.default_rng(0)
    stack = []
    for _ in range(60):
        shot = np.sqrt(noise.read**2 + noise.gain * level) * random.standard_normal(SHAPE)
        stack.append(images(np.rint(8.0 + level + shot)))
    spread = np.var(stack, axis=0, ddof=1).mean()
    assert spread == pytest.approx(told.variance(np.array(np.mean(stack))), rel=0.06)
    assert images.scale > 5.0 and told.bits > 12 and np.mean(stack) == pytest.approx(900.0 * images.scale, rel=1e-3)


def test_what_is_saturated_or_out_of_sight_does_not_count() -> None:
    view = SensorView.described(SHAPE, (24, 40), 20.0, bits=8)  # 40 · 20 columns are more than it has
    images = BeamImages(view, PIXELS)
    level = np.full(SHAPE, 100, np.uint8)
    level[240, 320] = 255
    seen = images(level)
    assert np.isnan(seen[:, :3]).all() and np.isfinite(seen[8:-8, 8:-8]).all()
    assert (seen == images.noise(SensorNoise(bits=8)).brightest).sum() >= 1
    with pytest.raises(ShapeMismatch, match=r"480 × 639 pixels; expected 480 × 640"):
        images(level[:, 1:])
    with pytest.raises(BadInput, match="show no pixel"):
        BeamImages(replace(view, origin=(1e4, 0.0)), PIXELS)
    with pytest.raises(BadInput, match="inverse"):
        replace(view, matrix=((1.0, 1.0), (1.0, 1.0)))
