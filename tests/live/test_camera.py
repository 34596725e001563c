"""The camera that watches a print, against truth that shares none of its operators."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from live import oracle

import vamgpu as vam
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.live import CameraPose, MonitoringCamera, SensorNoise, Turbidity
from vamgpu.printing.scatter import ScatterStop

GRID = vam.Grid((20, 20, 20), 0.2)
FULL = 0.25


def camera(device: Any, open_field: Any = 200.0, vessel: Any = None, **given: Any) -> MonitoringCamera:
    pitch = GRID.pitch * (1.0 if vessel is None else vessel.resin_index / vessel.bath_index)
    beam = vam.Beam((24, 24), pitch)
    rest = vam.Turntable(9, lit_share=0.0)
    return MonitoringCamera(vam.Projection(GRID, beam, rest, vessel, device), open_field, **given)


def vial(bath_index: float) -> vam.Vial:
    return vam.Vial(radius=6.0, wall=0.8, resin_index=1.48, wall_index=1.47, bath_index=bath_index)


@pytest.mark.parametrize("vessel", [None, vial(1.48), vial(1.0)], ids=["air", "matched", "refracting"])
def test_light_through_the_vial_is_that_of_traced_rays(device: Any, vessel: Any) -> None:
    eye = camera(device, 1.0, vessel)
    A, edge = eye.projection, 2.0 * GRID.pitch
    expected = oracle.images(GRID, A.beam, A.motion.poses, vessel, FULL, edge)
    found = eye.transmitted(FULL * oracle.on_voxels(GRID, edge))
    assert expected.min() < 0.7
    assert np.sqrt(np.mean((found - expected) ** 2)) < 3e-3
    assert np.abs(found - expected).max() < 0.02


def test_vignetting_and_the_dark_edge_of_an_image(device: Any) -> None:
    shade = 100.0 + np.arange(24 * 24.0).reshape(24, 24)
    images = camera(device, shade).transmitted(np.zeros(GRID.shape))
    assert images == pytest.approx(np.broadcast_to(shade, images.shape), rel=1e-6)


def test_a_focused_camera_sees_no_index_and_another_keeps_the_light(device: Any) -> None:
    x, y, z = np.meshgrid(*GRID.axes(), indexing="ij")
    index = 2e-3 * np.exp(-(x**2 + y**2 + z**2) / 0.5)
    clear = np.zeros(GRID.shape)
    assert np.ptp(camera(device).transmitted(clear, index)) < 1e-3
    plain, seen = (camera(device, focus=f).transmitted(clear, index) for f in (0.0, 3.0))
    assert np.ptp(seen) > 1.0
    assert seen.sum() == pytest.approx(plain.sum(), rel=1e-5)
    # A lens of rising index gathers light in front of the focus: bright in its middle.
    middle = seen[0, 11:13, 11:13].mean() / 200.0
    thickness = 2e-3 * np.sqrt(np.pi * 0.5)
    assert middle - 1.0 == pytest.approx(3.0 * 4.0 / 0.5 * thickness, rel=0.25)


def test_scattered_light_adds_up_to_the_density_that_stops_a_print(device: Any) -> None:
    """Eq. 1 of the automatic exposure paper is the integral of the images over the part."""
    eye, edge = camera(device, 50.0), 2.0 * GRID.pitch
    part = oracle.on_voxels(GRID, edge)
    stop = ScatterStop(voxels=float(part.sum()), threshold=1e6)
    background = 7.0
    for second, share in enumerate((0.0, 0.5, 1.0)):
        found = stop.see(float(second), eye.scattered(share * 0.02 * part, background)[0]).density
        expected = 50.0 * share * 0.02 * GRID.voxel_volume / eye.projection.beam.pixel_area
        assert found == pytest.approx(expected, rel=2e-3, abs=1e-6)


def test_a_pose_moves_images_and_centering_moves_them_back() -> None:
    field = np.zeros(GRID.shape)
    field[9:11, 9:11, 9:11] = 1.0
    pose = CameraPose(axis=0.4, height=-0.2, roll=0.1)
    seen = 1.0 - camera("numpy", 1.0, pose=pose).transmitted(field)[0]
    row, column = (np.sum(seen * np.arange(24.0).reshape(s)) / seen.sum() - 11.5 for s in ((24, 1), (1, 24)))
    assert (row, column) == pytest.approx((-1.0, 2.0), abs=0.02)
    off = np.zeros(GRID.shape)
    off[9:11, 9:11, 16] = 1.0  # above the middle, on the axis
    seen = 1.0 - camera("numpy", 1.0, pose=CameraPose(roll=0.1)).transmitted(off)[0]
    row, column = (np.sum(seen * np.arange(24.0).reshape(s)) / seen.sum() - 11.5 for s in ((24, 1), (1, 24)))
    assert (row, column) == pytest.approx((6.5 * np.cos(0.1), -6.5 * np.sin(0.1)), abs=0.05)
    smooth = 0.3 * oracle.on_voxels(GRID, 3.0 * GRID.pitch)
    straight, _ = camera("numpy").optical_depth(camera("numpy").transmitted(smooth))
    posed = camera("numpy", pose=pose)
    back, known = posed.optical_depth(posed.transmitted(smooth))
    assert np.abs(back - straight)[:, 4:-4, 4:-4].max() < 0.01
    assert known.min() >= 0.0


def test_noise_has_the_variance_it_says() -> None:
    noise = SensorNoise(read=1.5, gain=0.2, bits=10)
    levels = np.full((200, 200), 400.0)
    taken = noise.expose(levels, 0)
    assert taken.dtype == np.uint16
    assert taken.var() == pytest.approx(noise.variance(levels)[0, 0], rel=0.05)
    assert (noise.expose(levels, 1) != taken).any() and (noise.expose(levels, 0) == taken).all()
    assert noise.expose(levels + 1e4, 0).max() == 1023


def test_pixels_that_say_nothing_weigh_nothing() -> None:
    eye = camera("numpy", 200.0, noise=SensorNoise(read=1.0, bits=8))
    images = np.full(eye.shape, 100.0)
    images[0], images[1, 2, 3], images[2, 4, 5] = np.nan, 255.0, 1.0
    depth, weight = eye.optical_depth(images)
    dead = weight == 0.0
    assert dead[0].all() and dead[1, 3, 2] and dead[2, 5, 4] and np.count_nonzero(dead[1:]) == 2
    assert depth[~dead] == pytest.approx(np.log(2.0))
    assert weight[~dead] == pytest.approx(1e4 / (1.0 + 1.0 / 12.0))


@pytest.mark.parametrize("vial", [None, vam.Vial(6.0, 0.8, 1.48, 1.47, 1.3)])
def test_measured_on_a_device_as_in_numpy(device: Any, vial: Any) -> None:
    field = 200.0 + 10.0 * np.random.default_rng(0).random(camera("numpy").shape[1:])
    eye, posed = (camera(device, field, vial, noise=SensorNoise(1.0, 0.3, 8), pose=pose)
                  for pose in (CameraPose(), CameraPose(roll=1e-9)))  # fmt: skip
    images = np.random.default_rng(1).uniform(0.0, 270.0, eye.shape).astype(np.float32)
    images[0], images[1, 2, 3] = np.nan, np.inf
    (depth, weight), (want, known) = (tuple(a.numpy() for a in eye.measured(images)), eye.optical_depth(images))
    share = np.where(eye.reached > 1e-6, eye.reached, 0.0)
    assert depth == pytest.approx(want * share, abs=1e-5)
    assert weight == pytest.approx(np.divide(known, share**2, out=np.zeros_like(known), where=share > 0), rel=1e-5)
    assert (depth[..., 1:] != 0).any() and not weight[0].any()
    images[:2] = 100.0  # a pose resamples, and knows no more about what was lost
    for seen, turned in zip(eye.measured(images), posed.measured(images), strict=True):
        assert np.abs(turned.numpy() - seen.numpy()).max() < 1e-3 * np.abs(seen.numpy()).max()


def test_turbidity_there_and_back() -> None:
    resin = Turbidity((0.0, 0.3, 1.0), (0.0, 0.02, 0.3), (0.0, 1e-3, 8e-3))
    share = np.linspace(0.0, 1.0, 11)
    assert resin.conversion_at(resin.extinction_at(share)) == pytest.approx(share)
    assert resin.index_at(np.array([0.3, 1.0])) == pytest.approx([1e-3, 8e-3])
    step = (resin.conversion_at(np.array([0.101])) - resin.conversion_at(np.array([0.1]))) / 0.001
    assert resin.slope_at(np.array([0.1])) == pytest.approx(step)


def test_refusals() -> None:
    with pytest.raises(BadInput, match="absorbs"):
        camera("numpy", 1.0, vam.Vial(6.0, 0.8, 1.48, 1.47, 1.48, absorption=0.1))
    with pytest.raises(ShapeMismatch, match="open field"):
        camera("numpy", np.ones((3, 3)))
    with pytest.raises(BadInput, match="dark"):
        camera("numpy", 0.0)
    with pytest.raises(ShapeMismatch, match="images"):
        camera("numpy").optical_depth(np.ones((2, 2)))
    for wrong in ({"extinction": (0.0, 0.0)}, {"conversion": (0.0, 2.0)}, {"index": (0.0,)}, {"extinction": "red"}):
        with pytest.raises(BadInput):
            Turbidity(**wrong)  # type: ignore[arg-type]
    with pytest.raises(BadInput):
        SensorNoise(read=-1.0)
