"""Frames chosen by their dose: proved beside rays of another operator, written and read, on every device."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, NoLight, OutOfMemory, PackWarning
from vamgpu.kernels.flip import flip_pixels
from vamgpu.printing import fit
from vamgpu.printing.folder import load_frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import Solved

N, PITCH = 32, 0.1
VIAL = vam.Vial(radius=4.0, wall=0.3, resin_index=1.5, wall_index=1.47, absorption=0.05)


def cross(slices: int = 2) -> np.ndarray:
    """A cross, in its lower half; a bar above."""
    x, y = np.meshgrid(*2 * [np.arange(N) - 0.5 * (N - 1)], indexing="ij")
    near, bar = np.hypot(x, y) < 13, np.abs(x) < 3
    layers = [near & (bar | (np.abs(y) < 3)) if z < slices // 2 else near & bar for z in range(slices)]
    return np.stack(layers, axis=2).astype(np.float32)


def plan_on(device: Device, angles: int = 60, slices: int = 2, lit_share: float = 1.0) -> vam.Plan:
    A = vam.Projection(
        vam.Grid((N, N, slices), PITCH),
        vam.Beam((48, slices), PITCH),
        vam.Turntable(angles, lit_share=lit_share),
        VIAL,
        device,
    )
    return vam.optimize(A, cross(slices), "lbfgs", evaluations=40, progress=False)


@pytest.fixture(scope="module")
def plan() -> vam.Plan:
    return plan_on(vam.open_device(None))


@pytest.fixture(scope="module")
def bits(plan: vam.Plan) -> vam.Frames:
    """Of the plan, chosen by their dose."""
    return vam.pack(plan, bits=1, dither="fit")


def proved(plan: vam.Plan, frames: vam.Frames) -> float:
    A: Any = plan.operator
    return float(vam.simulate(A, frames, plan.target).scores.window)


@pytest.mark.slow
def test_most_of_the_window_is_left() -> None:
    plan = plan_on(vam.open_device(None), angles=240)
    diffused, fitted = (vam.pack(plan, bits=1, dither=how) for how in ("error-diffusion", "fit"))
    assert plan.window > 0.15 and proved(plan, diffused) < 0.8 * plan.window
    assert proved(plan, fitted) > plan.window - 0.02
    assert fitted.bits == 1 and set(np.unique(fitted.levels())) == {0, 1}
    assert proved(plan, fitted) == pytest.approx(fitted.plan.window, abs=0.02), "as it was claimed"


@pytest.mark.parametrize("case", [
    {"gray": GrayCurve.linear(black=0.01)},
    {"flat_field": 0.7 + 0.3 * np.random.default_rng(3).random((2, 48)), "flip_r": True, "shift": (2.0, 0.0),
     "flip_z": True},
])  # fmt: skip
@pytest.mark.slow
def test_any_projector_will_do(plan: vam.Plan, case: dict[str, Any]) -> None:
    diffused, fitted = (vam.pack(plan, bits=1, dither=how, **case) for how in ("error-diffusion", "fit"))
    assert proved(plan, fitted) > max(proved(plan, diffused), 0.0) + 0.05
    again = vam.pack(Solved(fitted.plan.sinogram, None), bits=1, scale=fitted.scale, **case)
    assert np.array_equal(again.levels(), fitted.levels())


@pytest.mark.slow
def test_light_is_driven_to_its_ends_before_pixels_are_flipped(
    plan: vam.Plan, bits: vam.Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OutOfMemory("no room")

    driven = bits
    monkeypatch.setattr(fit, "LIT", 0.8)  # dim pixels to begin with
    dim = vam.pack(plan, bits=1, dither="fit")
    assert proved(plan, dim) > proved(plan, driven) - 0.06 and dim.scale > 0.5 * driven.scale  # one doubling away
    monkeypatch.setattr(fit, "TwoLevels", full)
    flipped, diffused = (proved(plan, vam.pack(plan, bits=1, dither=how)) for how in ("fit", "error-diffusion"))
    assert proved(plan, driven) > flipped + 0.05 and flipped > 0.05 > diffused


@pytest.mark.slow
def test_light_that_frames_lose_is_not_counted_on(plan: vam.Plan, bits: vam.Frames) -> None:
    """Columns that are shifted off show nothing; the others make up for them."""
    moved = vam.pack(plan, bits=1, dither="fit", shift=(9.0, 0.0))
    assert proved(plan, moved) > proved(plan, bits) - 0.04


@pytest.mark.slow
def test_bits_take_no_longer_than_the_light_may() -> None:
    A = vam.Projection(vam.Grid((N, N, 1), PITCH), vam.Beam((48, 1), PITCH), vam.Turntable(60), VIAL)
    lamp: dict[str, Any] = {"irradiance": "65 mW/cm2", "critical_dose": "50 mJ/cm3"}
    plan = vam.optimize(A, cross(1), evaluations=60, exposure_limit=4.0, progress=False, **lamp)
    free = vam.optimize(A, cross(1), evaluations=60, progress=False)
    seconds = [vam.simulate(A, vam.pack(each, bits=1, dither="fit"), cross(1), **lamp).seconds for each in (plan, free)]
    assert seconds[0] is not None and seconds[1] is not None and seconds[0] < 1.1 * 4.0 < seconds[1]


@pytest.mark.parametrize("scale", [None, 1.0])
def test_dark_light_is_told(plan: vam.Plan, scale: float | None) -> None:
    dark = replace(plan, sinogram=plan.operator.device.upload(np.zeros(plan.operator.range.shape, np.float32)))
    with pytest.raises(NoLight, match="dark everywhere"):
        vam.pack(dark, bits=1, dither="fit", scale=scale)
    with pytest.raises(NoLight, match="shift"):
        vam.pack(plan, bits=1, dither="fit", scale=scale, shift=(100.0, 0.0))


def test_a_pixel_is_flipped_by_the_price_of_its_own_way(fast_device: Device) -> None:
    """Lit, lit, dark, dark; the error falls without the first and with the fourth."""
    given = {"brighter": [1, -1, 1, -1], "darker": [-1, 1, -1, 1], "step": [2] * 4, "light": [2, 2, 0, 0]}
    fields = {name: fast_device.upload(np.array(values, np.float32)[:, None, None]) for name, values in given.items()}
    change = fast_device.empty((4, 1, 1))
    fast_device.launch(flip_pixels, **fields, change=change)
    assert change.numpy().ravel().tolist() == [-2, 0, 0, 2]
    assert fields["light"].numpy().ravel().tolist() == [0, 2, 0, 2]


@pytest.mark.slow
def test_devices_agree(fast_device: Device) -> None:
    reference = plan_on(vam.open_device("numpy"), angles=16)
    scale = 0.5 * float(reference.sinogram.numpy().max())
    wanted = vam.pack(reference, bits=1, dither="fit", scale=scale)
    plan = plan_on(fast_device, angles=16)
    fitted = vam.pack(plan, bits=1, dither="fit", scale=scale)
    assert fitted.plan.window == pytest.approx(wanted.plan.window, abs=0.05), "ties fall either way"
    assert proved(plan, fitted) > proved(plan, vam.pack(plan, bits=1, dither="round")) + 0.2


def test_sides_and_the_usual_share(device: Device) -> None:
    plan = plan_on(device, angles=6, lit_share=0.0)
    A: Any = plan.operator
    target = plan.target
    found = fit._Fit(A, device.upload(cross()), plan.sinogram)
    side = np.where(A.grid.cylinder()[:, :, None], np.where(np.asarray(target) >= 0.5, 1, -1), 0)
    assert np.array_equal(found.side.numpy(), side)
    matrix = np.stack([np.asarray(A.T(row.reshape(A.range.shape))).ravel() for row in np.eye(A.shape[0])[48:96]])
    lit = matrix[:, side.ravel() != 0]
    assert found.share == pytest.approx((lit**2).sum() / lit.sum(), rel=0.3)


def test_some_poses_are_those_of_the_whole(device: Device) -> None:
    A = vam.Projection(vam.Grid((12, 12, 3), PITCH), vam.Beam((16, 3), PITCH), vam.Turntable(10), VIAL, device)
    rng, some = np.random.default_rng(0), [1, 4, 7]
    volume, light = rng.random(A.domain.shape, np.float32), np.zeros(A.range.shape, np.float32)
    light[some] = rng.random((3, 16, 3))
    assert np.allclose(np.asarray(A.of_poses(some)(volume)), np.asarray(A(volume))[some], rtol=1e-5)
    assert np.allclose(np.asarray(A.of_poses(some).T(light[some])), np.asarray(A.T(light)), rtol=1e-4, atol=1e-6)
    with pytest.raises(BadInput, match="angles of equal dwell"):
        vam.Projection(A.grid, A.beam, vam.Turntable(3, (1.0, 2.0, 1.0)), VIAL, device).of_poses([0])


def test_a_job_folder_keeps_the_bits(bits: vam.Frames, tmp_path: Path) -> None:
    bits.save(tmp_path / "cross.vam")
    kept = load_frames(tmp_path / "cross.vam")
    assert np.array_equal(kept.levels(), bits.levels()) and kept.settings.dither == "fit"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the light does not print at every corner")
def test_corners_are_those_of_the_bits() -> None:
    """Bits are chosen by the dose where nothing is off; what is claimed of all corners is what they leave there."""
    A = vam.Projection(vam.Grid((N, N, 2), PITCH), vam.Beam((48, 2), PITCH), vam.Turntable(45), VIAL)
    off = vam.Tolerances(axis=0.25 * PITCH)
    plan = vam.optimize(A, cross(), "lbfgs", iterations=8, tolerances=off, progress=False)
    kept = vam.pack(plan, bits=1, dither="fit").plan
    shown = off.doses(A, kept, cross())
    assert kept.window == pytest.approx(shown.window) != pytest.approx(plan.window)
    assert kept.corners is not None and kept.corners.statement() == shown.statement()


@pytest.mark.slow
def test_rings_are_fitted_by_rays() -> None:
    A = vam.RingProjection(vam.Grid((N, N, 2), PITCH), vam.Beam((48, 2), PITCH), vam.Turntable(60), VIAL)
    plan = vam.optimize(A, cross(), "lbfgs", evaluations=20, progress=False)
    fitted, rounded = (proved(plan, vam.pack(plan, bits=1, dither=how)) for how in ("fit", "round"))
    assert fitted > rounded + 0.2


def test_what_cannot_be_fitted_is_told(plan: vam.Plan) -> None:
    bodies = SimpleNamespace(name="two", limits=object())
    cases: tuple[tuple[Any, dict[str, Any], str], ...] = (
        (plan, {"bits": 1, "shift": (0.5, 0.0)}, "expected whole pixels"),
        (Solved(plan.sinogram, plan.operator), {"bits": 1}, "without a target"),
        (Solved(plan.sinogram, None, cross()), {"bits": 1}, "light of None"),
        (Solved(plan.sinogram, None, cross()), {"bits": 8}, "expected an operator on a Grid"),
        (Solved(plan.sinogram, plan.operator, bodies), {"bits": 1}, "'two', whose voxels have their own limits"),
    )
    for given, how, message in cases:
        with pytest.raises(BadInput, match=message):
            vam.pack(given, dither="fit", **how)


@pytest.mark.parametrize("case", [
    {},
    {"gray": GrayCurve.linear(black=0.0002)},
    {"flat_field": 0.7 + 0.3 * np.random.default_rng(3).random((2, 48)), "flip_r": True},
    {"shift": (2.0, 0.0), "flip_z": True},
])  # fmt: skip
def test_levels_of_8_bits_keep_the_window(device: Device, case: dict[str, Any]) -> None:
    """Eight rounds bring back what rounding costs, with any curve and field, on every device and any operator."""
    plan = replace(plan_on(device, lit_share=0.0), evaluations=120.0)
    peak = float(np.asarray(plan.sinogram).max())
    coarse: dict[str, Any] = {**case, "scale": 10.0 * peak}
    rounded, fitted = vam.pack(plan, dither="round", **coarse), vam.pack(plan, **coarse)
    assert fitted.settings.dither == "fit" and fitted.scale == rounded.scale
    found = fit._Fit(plan.operator, device.upload(cross()), plan.sinogram)
    lost = plan.window - found.window_of(rounded)
    assert lost > 0.006 and plan.window - found.window_of(fitted) < 0.7 * lost
    assert fitted.plan.window == pytest.approx(found.window_of(fitted), abs=1e-4)
    again = vam.pack(fitted.plan, dither="round", **coarse)
    assert np.array_equal(again.levels(), fitted.levels()), "the plan's light is rounded to the frames"
    assert (np.abs(fitted.levels().astype(int) - rounded.levels()) > 0).mean() < 0.1


def test_what_8_bits_are_fitted_by_default(plan: vam.Plan) -> None:
    """A plan that took ten times as many evaluations, and whose target tells all that is asked for."""
    assert vam.pack(plan).settings.dither == "fit"
    assert vam.pack(replace(plan, evaluations=14.0)).settings.dither == "round"
    assert vam.pack(replace(plan, tolerances=vam.Tolerances(axis=0.1))).settings.dither == "round"
    assert vam.pack(replace(plan, target=None)).settings.dither == "round"
    light = Solved(plan.sinogram, plan.operator, cross())
    assert vam.pack(light).settings.dither == "round" and vam.pack(light, dither="fit").settings.dither == "fit"


@pytest.mark.slow
def test_bits_keep_most_of_the_dose_by_default(plan: vam.Plan) -> None:
    """By the dose of all pixels where it is known, else by carrying errors on, where angles are lit as long."""
    frames, rounded = vam.pack(plan, bits=1), vam.pack(plan, bits=1, dither="round")
    assert frames.settings.dither == "fit" and proved(plan, frames) > max(proved(plan, rounded), 0.0)
    A, light = plan.operator, plan.sinogram
    own = vam.pack(A, light, target=cross(), bits=1)
    assert np.array_equal(own.levels(), frames.levels())
    two = vam.pack(Solved(light, A, cross()), bits=1), vam.pack(A, light, bits=1)  # another color's dose, no target
    assert {each.settings.dither for each in (*two, vam.pack(plan, bits=1, shift=(0.5, 0.0)))} == {"error-diffusion"}
    uneven = SimpleNamespace(motion=vam.Turntable(np.arange(60.0) / 10.0, np.arange(1.0, 61.0)), range=A.range)
    assert vam.pack(Solved(light, uneven), bits=1).settings.dither == "round"  # type: ignore[arg-type]


def test_a_quantile_says_how_bright_a_pixel_of_1_bit_is(plan: vam.Plan) -> None:
    scale = vam.pack(plan, quantile=0.9, dither="round").scale
    frames = vam.pack(plan, bits=1, quantile=0.9)
    assert frames.scale == pytest.approx(scale) and frames.settings.dither == "fit"
    assert np.array_equal(frames.levels(), vam.pack(plan, bits=1, scale=scale).levels())


def test_rounding_stays_where_it_is_as_good(plan: vam.Plan) -> None:
    """Light of two levels is rounded without loss, and what no inverse makes up for is flipped alone."""
    A = vam.Projection(vam.Grid((N, N, 2), PITCH), vam.Beam((48, 2), PITCH), vam.Turntable(np.linspace(0.0, 5.0, 60)))
    bits = (plan.sinogram.numpy() > 0.3 * plan.sinogram.numpy().max()).astype(np.float32)
    two = replace(plan, operator=A, sinogram=A.device.upload(bits))
    with pytest.warns(PackWarning, match="the frames are rounded"):
        frames = vam.pack(two, bits=1, dither="fit", scale=1.0)
    assert np.array_equal(frames.irradiance().numpy(), bits)
