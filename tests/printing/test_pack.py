"""Packing: levels nearest to the light, robust scale, placement, dithering, all on the plan's device."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import optional

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, NoLight, ShapeMismatch
from vamgpu.jobs.run import prove
from vamgpu.printing.folder import load_frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import Solved, pack

SHAPE = (24, 21, 35)


def plan_of(device: Device, light: np.ndarray) -> Any:
    return SimpleNamespace(sinogram=device.upload(light), operator=None)


def some_light(seed: int = 0, shape: tuple[int, int, int] = SHAPE) -> np.ndarray:
    """Light as plans have it: dark in half of all pixels, float32 so that every device starts from the same."""
    return np.maximum(np.random.default_rng(seed).normal(size=shape), 0.0).astype(np.float32)


class Foreign:
    """An array of a library that knows DLPack alone."""

    def __init__(self, values: np.ndarray) -> None:
        self.values, self.shape = values, values.shape

    def __dlpack__(self, **how: Any) -> Any:
        return self.values.__dlpack__(**how)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.values.__dlpack_device__()


def foreign_double(values: np.ndarray) -> Foreign:
    """One that a reference device of float64 need not cast."""
    return Foreign(values.astype(float))


class Listed:
    """An array of a library that knows ``__array__`` alone."""

    def __init__(self, values: np.ndarray) -> None:
        self.values, self.shape = values, values.shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype)


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


def of_jax(values: np.ndarray) -> Any:
    optional("jax", "install JAX: pip install vamgpu[jax]")
    return __import__("jax").numpy.asarray(values)


def of_torch(values: np.ndarray) -> Any:
    optional("torch", "install PyTorch: pip install vamgpu[torch]")
    return __import__("torch").tensor(values)


LIBRARIES = [np.array, partial(np.array, dtype=float), Foreign, foreign_double, Listed, of_jax, of_torch]


@pytest.mark.parametrize("library", LIBRARIES)
def test_light_of_ones_own_is_packed(device: Device, library: Any, tmp_path: Path) -> None:
    """Arrays that are NumPy's, of another type, known by DLPack or ``__array__`` alone, other libraries'; copied."""
    A = vam.Projection(vam.Grid((21, 21, 35), 0.1), vam.Beam((21, 35), 0.1), vam.Turntable(24), device=device)
    own = some_light()
    given = library(own)
    frames = pack(A, given, dither="round")
    wanted = pack(Solved(device.upload(own), A))
    assert np.array_equal(frames.levels(), wanted.levels()) and frames.scale == wanted.scale
    own *= 2.0
    for theirs in (given, getattr(given, "values", None)):
        if isinstance(theirs, np.ndarray) and theirs is not own:
            theirs *= 2.0
    assert np.array_equal(frames.plan.sinogram.numpy() * 2.0, own), "the light is a copy"
    again = load_frames(frames.save(tmp_path / "own.vam"), device)
    assert np.array_equal(again.levels(), frames.levels())


def test_light_of_ones_own_is_proved_from_its_folder(tmp_path: Path) -> None:
    A = vam.Projection(vam.Grid((21, 21, 9), 0.1), vam.Beam((25, 9), 0.1), vam.Turntable(24))
    part = np.zeros(A.domain.shape, np.float32)
    part[8:13, 8:13] = 1.0
    light = A(part)
    frames = pack(A, light, target=part)
    proof = vam.simulate(A, frames, part)
    assert proof.scores.iou > 0.5
    again = prove(frames.save(tmp_path / "own.vam")).proof
    assert again.scores == proof.scores
    light /= A.T(light)[part > 0].mean()
    begun = vam.optimize(A, part, start=light, iterations=0, progress=False)
    assert begun.history == () and np.allclose(begun.sinogram.numpy(), light)
    assert np.array_equal(pack(begun).levels(), frames.levels()), "rounded, as no evaluations were spent"


@pytest.mark.parametrize("library", [np.asarray, Foreign])
def test_light_that_cannot_be_shown_is_refused(device: Device, library: Any) -> None:
    A = vam.Projection(vam.Grid((21, 21, 35), 0.1), vam.Beam((21, 35), 0.1), vam.Turntable(24), device=device)
    for value, message in ((-1.0, "the light reaches from -1 to"), (np.nan, "holds NaN"), (np.inf, "infinity")):
        light = some_light()
        light[3, 4, 5] = value
        with pytest.raises(BadInput, match=message):
            pack(A, library(light))
    with pytest.raises(
        ShapeMismatch, match=r"the light has shape \(24, 35, 21\); expected an array of shape \(24, 21, 35\)"
    ):
        pack(A, library(some_light(shape=(24, 35, 21))))
    with pytest.raises(NoLight):
        pack(A, library(np.zeros(SHAPE, np.float32)))
    with pytest.raises(BadInput, match=r"got only a Projection; expected .* vam\.pack\(A, light\)"):
        pack(A)
    with pytest.raises(BadInput, match="the operator that makes dose from it"):
        pack(plan_of(device, some_light()), library(some_light()))
    with pytest.raises(BadInput, match=r"got only a ndarray; expected .* vam\.pack\(A, light\)"):
        pack(some_light())  # pyright: ignore[reportArgumentType]
    with pytest.raises(BadInput, match="^got light with a ndarray; expected it with the operator"):
        pack(some_light(), A)  # pyright: ignore[reportArgumentType]
    with pytest.raises(
        ShapeMismatch, match=r"the target has shape \(3, 3, 3\); expected an array of shape \(21, 21, 35\)"
    ):
        pack(A, library(some_light()), target=np.ones((3, 3, 3)))


def test_bits_by_place_are_those_by_name(device: Device) -> None:
    plan = plan_of(device, some_light())
    with pytest.warns(DeprecationWarning, match=r"bits=, gray= by name"):
        frames = pack(plan, 1, GrayCurve.linear(black=0.01), dither="round")  # type: ignore[misc]
    wanted = pack(plan, bits=1, gray=GrayCurve.linear(black=0.01), dither="round")
    assert frames.gray == wanted.gray and np.array_equal(frames.levels(), wanted.levels())


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
