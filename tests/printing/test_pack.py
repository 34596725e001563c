"""Packing: levels nearest to the light, robust scale, placement, dithering, all on the plan's device."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, NoLight, ShapeMismatch
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import Solved, pack

SHAPE = (24, 21, 35)


def plan_of(device: Device, light: np.ndarray) -> Any:
    return SimpleNamespace(sinogram=device.upload(light), operator=None)


def some_light(seed: int = 0, shape: tuple[int, int, int] = SHAPE) -> np.ndarray:
    """Light as plans have it: dark in half of all pixels, float32 so that every device starts from the same."""
    return np.maximum(np.random.default_rng(seed).normal(size=shape), 0.0).astype(np.float32)


CASES = {
    "plain": {},
    "gamma and black": {"gray": GrayCurve.gamma(2.2, black=0.02)},
    "measured": {"gray": GrayCurve((0, 30, 90, 255), (0.01, 0.01, 0.4, 1.0)), "quantile": 0.97},
    "bits": {"bits": 1},
    "dithered bits": {"bits": 1, "dither": "error-diffusion", "gray": GrayCurve.linear(black=0.01)},
    "dithered bytes": {"dither": "error-diffusion", "gray": GrayCurve.gamma(2.0)},
    "flipped": {"flip_r": True, "flip_z": True},
    "shifted": {"shift": (2.25, -3.5), "flip_r": True},
    "flat field": {"flat_field": 0.6 + 0.4 * np.random.default_rng(9).random((35, 21)), "shift": (0.0, 0.4)},
}


@pytest.mark.parametrize("case", CASES)
def test_devices_agree_with_the_reference(fast_device: Device, case: str) -> None:
    light = some_light()
    frames = pack(plan_of(fast_device, light), **CASES[case])
    reference = pack(plan_of(vam.open_device("numpy"), light), **CASES[case])
    assert frames.scale == pytest.approx(reference.scale, rel=1e-6)
    apart = np.abs(frames.levels().astype(int) - reference.levels())
    assert (apart > 0).mean() <= 1e-3  # light midway between two levels may round either way
    shown, wanted = frames.irradiance("numpy").numpy(), reference.irradiance().numpy()
    assert (np.abs(shown - wanted) > 1e-5 * wanted.max()).mean() <= 4e-3  # a level lies on up to four pixels


@pytest.mark.parametrize("case", CASES)
def test_the_layout_of_gpus_agrees(opencl_name: str, case: str) -> None:
    """Many items a slab and groups that count together, on whatever runs OpenCL here."""
    from vamgpu.backend.opencl import OpenclDevice
    from vamgpu.backend.opencl_platforms import context_of

    device = OpenclDevice(opencl_name, context_of(opencl_name))
    device.is_gpu = True
    light = some_light()
    frames, reference = (pack(plan_of(d, light), **CASES[case]) for d in (device, vam.open_device("numpy")))
    assert frames.scale == pytest.approx(reference.scale, rel=1e-6)
    assert (frames.levels() != reference.levels()).mean() <= 1e-3
    assert np.allclose(frames.irradiance().numpy(), frames.irradiance("numpy").numpy(), rtol=1e-5, atol=1e-6)


def test_the_round_trip_errs_by_half_a_level_at_most(device: Device) -> None:
    curve = GrayCurve.gamma(1.7, black=0.015)
    light = some_light()
    frames = pack(plan_of(device, light), gray=curve, quantile=1.0)
    assert frames.scale == pytest.approx(light.max(), rel=1e-6)
    shown = frames.irradiance().numpy() / frames.scale
    wanted = light / frames.scale
    nearest = np.abs(curve.table(8)[:, None] - wanted.ravel()).min(axis=0).reshape(wanted.shape)
    assert np.abs(np.abs(shown - wanted) - nearest).max() <= 2e-6
    assert np.allclose(shown[light == 0], 0.015, rtol=1e-5)


def test_rows_go_from_the_top_and_columns_from_small_r(device: Device) -> None:
    light = np.zeros(SHAPE)
    light[5, 3, 30] = 1.0
    where = {
        (False, False): (35 - 1 - 30, 3),
        (True, False): (35 - 1 - 30, 21 - 1 - 3),
        (False, True): (30, 3),
        (True, True): (30, 21 - 1 - 3),
    }
    for (flip_r, flip_z), (row, column) in where.items():
        for bits in (8, 1):
            frames = pack(plan_of(device, light), bits=bits, flip_r=flip_r, flip_z=flip_z)
            assert np.argwhere(frames.levels()).tolist() == [[5, row, column]]
            assert np.argwhere(frames.irradiance().numpy()).tolist() == [[5, 3, 30]]


def test_bits_are_folded_from_the_left(device: Device) -> None:
    frames = pack(plan_of(device, some_light()), bits=1)
    levels = frames.levels()
    assert frames.images.shape == (24, 35, 3) and levels.shape == (24, 35, 21)
    assert np.array_equal(frames.images.numpy(), np.packbits(levels, axis=-1))
    assert set(np.unique(levels)) == {0, 1}


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.5, 0.25)])
def test_a_hot_pixel_does_not_dim_the_print(device: Device, shift: tuple[float, float]) -> None:
    light = some_light()
    calm = pack(plan_of(device, light), shift=shift)
    brightest = pack(plan_of(device, light), shift=shift, quantile=1.0).scale
    light[7, 8, 9] = 1e6
    hot = pack(plan_of(device, light), shift=shift)
    assert calm.scale == brightest  # nothing is cut of light without any
    assert hot.scale == pytest.approx(2.0 * pack(plan_of(device, light), shift=shift, quantile=0.99999).scale)
    assert hot.scale <= 2.0 * brightest * (1 + 1e-6)
    assert hot.levels()[7, 35 - 1 - 9, 8] == 255
    shown, wanted = (np.delete(frames.levels() * frames.scale / 255, 7, axis=0) for frames in (hot, calm))
    assert np.abs(np.minimum(shown, calm.scale) - wanted).max() <= 1.01 * hot.scale / 255


@pytest.mark.parametrize(("hot", "scale"), [(2, 2.0), (10, 1000.0)])
def test_few_pixels_are_hot(fast_device: Device, hot: int, scale: float) -> None:
    """Of 262,144, one in a hundred thousand is three."""
    light = np.ones((64, 64, 64), np.float32)
    light[0, 0, :hot] = 1000.0
    A = vam.Projection(vam.Grid((64, 64, 64), 0.1), vam.Beam((64, 64), 0.1), vam.Turntable(64), None, fast_device)
    assert pack(Solved(fast_device.upload(light), A)).scale == pytest.approx(scale)


def test_the_scale_is_the_quantile_of_the_lit_pixels(device: Device) -> None:
    light = some_light()
    lit = np.sort(light[light > 0])
    for quantile in (0.5, 0.9, 0.999):
        spared = int(np.ceil((1 - quantile) * lit.size))
        scale = pack(plan_of(device, light), quantile=quantile).scale
        assert scale == pytest.approx(lit[lit.size - spared - 1], rel=3e-7)
    assert pack(plan_of(device, light), quantile=1.0).scale == pytest.approx(lit[-1], rel=3e-7)
    assert pack(plan_of(device, light), scale=2.5).scale == 2.5


def test_a_shift_moves_light_and_loses_none_inside(device: Device) -> None:
    light = np.zeros(SHAPE)
    light[:, 8:13, 12:22] = some_light(shape=(24, 5, 10))
    total = light.sum()
    plain = pack(plan_of(device, light), scale=4.0)
    for dr, dz in ((3.0, -4.0), (0.5, 0.5), (-2.3, 5.9)):
        frames = pack(plan_of(device, light), scale=4.0, shift=(dr, dz))
        pictures = frames.levels().astype(float) / 255 * 4.0
        assert pictures.sum() == pytest.approx(total, rel=4e-3)
        rows, columns = np.arange(35), np.arange(21)
        before = plain.levels().astype(float)
        for axis, places, moved in ((2, columns, dr), (1, rows, -dz)):
            other = 3 - axis
            middle = [(p.sum((0, other)) * places).sum() / p.sum() for p in (pictures, before)]
            assert middle[0] - middle[1] == pytest.approx(moved, abs=0.02)
        assert frames.irradiance().numpy().sum() == pytest.approx(total, rel=4e-3)


def test_whole_shifts_come_back_and_never_wrap(device: Device) -> None:
    light = some_light() + np.float32(0.1)
    plain = pack(plan_of(device, light), scale=3.0).levels()
    moved = pack(plan_of(device, light), scale=3.0, shift=(4.0, 2.0))
    pictures = moved.levels()
    assert np.array_equal(pictures[:, :-2, 4:], plain[:, 2:, :-4])
    assert not pictures[:, :, :4].any() and not pictures[:, -2:, :].any()
    back = moved.irradiance().numpy()
    assert not back[:, -4:].any() and not back[:, :, -2:].any()
    assert np.abs(back[:, :-4, :-2] - np.minimum(light, 3.0)[:, :-4, :-2]).max() <= 0.51 * 3.0 / 255
    assert not pack(plan_of(device, light), scale=3.0, shift=(100.0, 0.0)).levels().any()


def test_a_flat_field_is_made_up_for(device: Device) -> None:
    flat = np.linspace(0.5, 1.0, 35)[:, None] * np.linspace(0.8, 1.0, 21)
    light = np.minimum(some_light(), 2.0)
    frames = pack(plan_of(device, light), flat_field=2.0 * flat, quantile=1.0)
    assert frames.scale > 2.0
    assert np.abs(frames.irradiance().numpy() - light).max() <= 0.51 * frames.scale / 255
    naive = pack(plan_of(device, light), scale=frames.scale)
    assert (frames.levels() >= naive.levels()).all()
    assert frames.levels()[:, 0].sum() > 1.5 * naive.levels()[:, 0].sum()


def test_everything_stays_on_the_device(device: Device) -> None:
    plan = plan_of(device, some_light())
    with device.no_transfers():
        for bits, dither in ((8, "round"), (1, "error-diffusion")):
            frames = pack(plan, bits=bits, dither=dither)
            frames.irradiance()
    assert frames.device is device


def disk() -> tuple[Any, np.ndarray]:
    """A straight projection and the filtered, clipped light of a disk with a hole."""
    grid = vam.Grid((48, 48, 8), 0.1)
    A = vam.Projection(grid, vam.Beam((48, 8), 0.1), vam.Turntable(180), device="numpy")
    x, y, _ = grid.axes()
    part = np.zeros(grid.shape)
    part[(x[:, None] ** 2 + y**2 < 1.7**2) & ((x[:, None] - 0.3) ** 2 + y**2 > 0.5**2)] = 1.0
    rows = np.fft.rfft(A(part), axis=1) * (np.fft.rfftfreq(48)[:, None] + 0.01)
    return A, np.maximum(np.fft.irfft(rows, 48, axis=1), 0.0)


def test_dithered_bits_give_the_dose_of_the_light(device: Device) -> None:
    A, light = disk()
    inside = A.grid.cylinder()
    errors = {}
    for dither in ("round", "error-diffusion"):
        frames = pack(plan_of(device, light), bits=1, dither=dither)
        wanted = A.T(np.minimum(light, frames.scale))
        errors[dither] = (A.T(frames.irradiance("numpy").numpy()) - wanted)[inside] / wanted.max()
        if dither == "error-diffusion":
            assert abs(errors[dither].mean()) <= 2e-3
    assert errors["error-diffusion"].std() <= 0.4 * errors["round"].std()
    assert np.abs(errors["error-diffusion"]).max() <= 0.5 * np.abs(errors["round"]).max()


def test_error_is_carried_from_angle_to_angle(device: Device) -> None:
    light = np.full((100, 6, 5), 0.37)
    light[:, 0] = 0.0
    frames = pack(plan_of(device, light), bits=1, dither="error-diffusion", scale=1.0)
    lit = frames.levels().sum(axis=0)
    assert not lit[:, 0].any()
    assert np.abs(lit[:, 1:] - 37).max() <= 1
    assert np.ptp(frames.levels()[:, :, 1:].sum(axis=(1, 2))) <= 10  # neighbours do not flash in step


def test_bad_plans_are_refused(device: Device) -> None:
    with pytest.raises(NoLight, match="found no light"):
        pack(plan_of(device, np.zeros(SHAPE)))
    with pytest.raises(BadInput, match="1 or 8"):
        pack(plan_of(device, some_light()), bits=4)
    with pytest.raises(BadInput, match="scale"):
        pack(plan_of(device, some_light()), scale=-1.0)
    with pytest.raises(BadInput, match="expected a GrayCurve"):
        pack(plan_of(device, some_light()), gray=2.2)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="ndarray"):
        pack(SimpleNamespace(sinogram=some_light(), operator=None))  # type: ignore[arg-type]
    with pytest.raises(ShapeMismatch, match="flat field"):
        pack(plan_of(device, some_light()), flat_field=np.ones((21, 35)))
    A = vam.Projection(vam.Grid((4, 4, 2), 0.1), vam.Beam((4, 2), 0.1), vam.Turntable(3), device=device)
    with pytest.raises(ShapeMismatch, match="sinogram"):
        pack(SimpleNamespace(sinogram=device.upload(some_light()), operator=A))  # type: ignore[arg-type]


def test_light_that_is_not_finite_is_refused(device: Device) -> None:
    plan = plan_of(device, np.full(SHAPE, 3e38))
    device_flat = np.full(SHAPE[:0:-1], 1.0)
    device_flat[0, 0] = 1e-3  # makes the wanted light there exceed what a float32 holds
    with pytest.raises(BadInput, match="not finite"):
        pack(plan, flat_field=device_flat)
