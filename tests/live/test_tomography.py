"""The field of conversion behind the images of a turn, against a truth that shares no operator."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from live import oracle

import vamgpu as vam
from vamgpu.errors import BadInput
from vamgpu.live import MonitoringCamera, SensorNoise, Tomograph, Turbidity
from vamgpu.live.tomography import Reconstruction

GRID = vam.Grid((40, 40, 40), 0.2)
EDGE = 1.5 * GRID.pitch
FULL = 0.25
OPEN = 200.0 * (1.0 - 0.3 * np.linspace(-1.0, 1.0, 40) ** 2)
NOISE = SensorNoise(read=2.0, bits=8)
VIALS = {
    "matched": vam.Vial(radius=8.5, wall=1.0, resin_index=1.48, wall_index=1.47, bath_index=1.48),
    "refracting": vam.Vial(radius=8.5, wall=1.0, resin_index=1.48, wall_index=1.47, bath_index=1.0),
}


def camera(kind: str, device: Any) -> MonitoringCamera:
    vial = VIALS[kind]
    beam = vam.Beam((40, 40), GRID.pitch * vial.resin_index / vial.bath_index)
    A = vam.Projection(GRID, beam, vam.Turntable(180), vial, device)
    return MonitoringCamera(A, np.broadcast_to(OPEN, (40, 40)), NOISE)


@cache
def turn(kind: str) -> np.ndarray:
    """Images without noise."""
    A = camera(kind, "numpy").projection
    return OPEN * oracle.images(GRID, A.beam, A.motion.poses, VIALS[kind], FULL, EDGE)


@cache
def truth() -> np.ndarray:
    return oracle.on_voxels(GRID, EDGE)


def noisy(kind: str, seed: int) -> np.ndarray:
    """Images with noise of 1 % of the open field's brightest pixel."""
    return turn(kind) + 2.0 * np.random.default_rng(seed).standard_normal(turn(kind).shape)


def error(seen: Reconstruction) -> float:
    """RMS of the error over that of the conversion, in the cylinder that every image has whole."""
    x, y, _ = GRID.axes()
    inside = (np.hypot(x[:, None], y) < 3.9)[:, :, None]
    return float(np.linalg.norm((seen.conversion - truth()) * inside) / np.linalg.norm(truth() * inside))


@pytest.fixture
def quick() -> str:
    """The fastest device here."""
    return vam.devices()[0]


@pytest.mark.parametrize(("kind", "rings"), [("matched", True), ("refracting", False), ("refracting", True)])
@pytest.mark.slow
def test_conversion_is_known_to_five_percent(kind: str, rings: bool, quick: str) -> None:
    tomograph = Tomograph(camera(kind, quick), Turbidity(extinction=(0.0, FULL)), rings=rings)
    assert isinstance(tomograph.operator, vam.RingProjection) == rings
    first = tomograph.see(noisy(kind, 0))
    second = tomograph.see(noisy(kind, 1), first, iterations=12)
    assert error(first) < 0.055
    assert error(second) < 0.05
    assert error(second) < error(first)
    assert 0.7 < second.misfit < 1.0
    assert first.extinction.min() >= 0.0


@pytest.mark.slow
def test_a_warm_start_needs_fewer_pairs(quick: str) -> None:
    tomograph = Tomograph(camera("matched", quick), Turbidity(extinction=(0.0, FULL)))
    known = tomograph.see(noisy("matched", 0))
    cold, warm = (tomograph.see(noisy("matched", 1), last, iterations=4) for last in (None, known))
    assert error(warm) < 0.05 < 2.0 * error(warm) < error(cold)


def test_devices_agree(fast_device: Any) -> None:
    images = noisy("refracting", 0)
    found, expected = (
        Tomograph(camera("refracting", d), Turbidity(extinction=(0.0, FULL))).see(images, iterations=1).conversion
        for d in (fast_device, "numpy")
    )
    assert np.abs(found - expected).max() < 1e-4


def test_depths_less_their_bias_are_what_rays_add_up_to(fast_device: Any) -> None:
    """Light is spread, not its logarithm, so that edges seem less deep."""
    eye, field = camera("refracting", fast_device), np.asarray(FULL * truth(), np.float32)
    tomograph = Tomograph(eye, Turbidity(extinction=(0.0, FULL)))
    told, rays = tomograph.measure(eye.transmitted(field)), np.asarray(eye.projection(field))
    lifted = fast_device.upload(field)
    less = tomograph._unbiased(
        told.depth, lifted, tomograph.operator(lifted), Reconstruction(lifted, lifted, 1.0, 0.0)
    ).numpy()
    good = told.weight.numpy() > 0.0
    assert told.pixels == np.count_nonzero(good) > 0.3 * good.size
    assert np.abs(less - rays)[good].max() < 1e-3 < 0.1 * np.abs(told.depth.numpy() - rays)[good].max()


def test_frames_that_are_lost_cost_little(quick: str) -> None:
    tomograph = Tomograph(camera("matched", quick), Turbidity(extinction=(0.0, FULL)))
    images = noisy("matched", 0)
    whole = tomograph.see(images)
    images[20:30] = np.nan
    assert error(tomograph.see(images)) < error(whole) + 0.02
    with pytest.raises(BadInput, match="no pixel"):
        tomograph.see(np.full_like(images, np.nan))


def test_the_same_iterations_give_the_same_field(quick: str) -> None:
    tomograph = Tomograph(camera("matched", quick), Turbidity(extinction=(0.0, FULL)))
    images = noisy("matched", 0)
    first, again, more = (tomograph.see(images, iterations=count) for count in (1, 1, 2))
    assert np.array_equal(first.extinction, again.extinction) and not np.array_equal(first.extinction, more.extinction)
    with pytest.raises(BadInput, match="iterations"):
        tomograph.see(images, iterations=0)


def test_a_camera_of_other_rows_than_slices_knows_its_deviation(quick: str) -> None:
    full = camera("matched", quick)
    A = vam.Projection(GRID, vam.Beam((40, 30), GRID.pitch), vam.Turntable(180), VIALS["matched"], quick)
    low = MonitoringCamera(A, np.broadcast_to(OPEN, (30, 40)), NOISE)
    resin, images = Turbidity(extinction=(0.0, FULL)), noisy("matched", 0)
    expected = Tomograph(full, resin).deviation(images, iterations=3)[:, :, 10:30]
    found = Tomograph(low, resin).deviation(images[:, 5:-5], iterations=3)[:, :, 10:30]
    assert np.median(found) == pytest.approx(np.median(expected), rel=0.05)


@pytest.mark.slow
def test_the_deviation_is_that_of_repeated_turns(quick: str) -> None:
    tomograph = Tomograph(camera("matched", quick), Turbidity(extinction=(0.0, FULL)))
    fields = [tomograph.see(noisy("matched", seed), iterations=20).extinction for seed in range(8)]
    inside = np.min(fields, axis=0) > 0.3 * FULL  # where nothing is held at 0
    found = np.sqrt(np.mean(np.var(fields, axis=0, ddof=1)[inside]))
    said = np.sqrt(np.mean(tomograph.deviation(noisy("matched", 9), iterations=20)[inside] ** 2))
    assert said == pytest.approx(found, rel=0.15)


def test_the_misfit_of_no_field_is_that_of_the_depths(quick: str) -> None:
    eye, images = camera("refracting", quick), np.full((180, 40, 40), 100.0)
    depth, weight = eye.optical_depth(images)
    assert eye.reached.max() < 0.99
    seen = Tomograph(eye, Turbidity(extinction=(0.0, FULL))).see(images, iterations=1)
    assert seen.misfit == pytest.approx(np.mean(weight * depth**2), rel=1e-4)
