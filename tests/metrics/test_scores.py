"""Scores on every device against the plain computation."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, DeviceError, ShapeMismatch
from vamgpu.metrics import mean_brightness, score, score_slices
from vamgpu.metrics.light import light_sent, outside_over_inside
from vamgpu.metrics.parts import Parts


def _plain() -> ModuleType:
    spec = importlib.util.spec_from_file_location("metrics_plain", Path(__file__).with_name("plain.py"))
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


plain = _plain()

SHAPES = [(37, 41, 23), (24, 24, 70), (16, 16, 1)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("noise", [0.0, 0.05, 0.5])
def test_scores_of_the_whole_volume(device: Device, shape: tuple[int, int, int], noise: float) -> None:
    dose, target = plain.example(shape, 1, noise)
    out, into = plain.split(dose, target)
    peak = max(out.max(), into.max())
    got = score(device.upload(dose), device.upload(target))
    assert (got.in_voxels, got.out_voxels) == (len(into), len(out))
    assert got.peak == pytest.approx(peak, rel=1e-6)
    assert got.windows.strict == pytest.approx((into.min() - out.max()) / peak, abs=1e-6)
    assert got.dose_range == pytest.approx((into.max() - into.min()) / peak, abs=1e-6)
    low, high = np.quantile(into, 0.01, method="lower"), np.quantile(out, 0.99, method="higher")
    assert got.windows.trimmed == pytest.approx((low - high) / peak, abs=1e-6)
    assert got.windows.one_sided == pytest.approx((into.min() - high) / peak, abs=1e-6)
    low, high = np.quantile(into, 0.001, method="lower"), np.quantile(out, 0.999, method="higher")
    assert got.windows.fine == pytest.approx((low - high) / peak, abs=1e-6)
    assert got.overlap_rate == pytest.approx((out >= into.min()).sum() / (len(out) + len(into)), abs=1e-12)
    assert got.total_in == pytest.approx(into.astype(np.float64).sum(), rel=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("noise", [0.0, 0.05, 0.5])
def test_the_best_threshold(device: Device, shape: tuple[int, int, int], noise: float) -> None:
    dose, target = plain.example(shape, 2, noise)
    out, into = plain.split(dose, target)
    got = score(device.upload(dose), device.upload(target))
    assert got.iou == pytest.approx(plain.best_iou(out, into), abs=1e-9)
    missing, excess = (into < got.threshold).sum(), (out >= got.threshold).sum()
    assert (got.missing, got.excess) == (missing, excess)
    assert got.error_rate == pytest.approx((missing + excess) / (len(out) + len(into)), abs=1e-12)


def test_a_dose_with_a_window_prints_perfectly(device: Device) -> None:
    _, target = plain.example((30, 30, 20), 3, 0.0)
    dose = np.where(target >= 0.5, 0.9, 0.4).astype(np.float32)
    dose[15, 15, 6], dose[2, 15, 3] = 1.0, 0.0
    got = score(device.upload(dose), device.upload(target))
    assert (got.iou, got.error_rate, got.overlap_rate) == (1.0, 0.0, 0.0)
    assert got.window == pytest.approx(0.5, abs=1e-6)
    assert got.threshold == pytest.approx(0.65, abs=1e-6)


def test_no_threshold_prints_what_gets_no_light(device: Device) -> None:
    """A part of which a third lies in the dark, beside a void that is as bright as the rest: all of it is best."""
    target = np.zeros((20, 20, 9), np.float32)
    target[4:16, 4:16] = 1.0
    dose = np.ones(target.shape, np.float32)
    dose[..., :3] = 0.0
    got = score(device.upload(dose), device.upload(target))
    assert 0.0 < got.threshold <= 1.0 and got.missing == 12 * 12 * 3
    dose[target < 0.5] = 0.0  # a void without light
    got = score(device.upload(dose), device.upload(target))
    assert 0.0 < got.threshold <= 1.0 and (got.missing, got.excess) == (12 * 12 * 3, 0)


def test_a_given_threshold_is_kept(device: Device) -> None:
    dose, target = plain.example((20, 20, 9), 4, 0.3)
    out, into = plain.split(dose, target)
    got = score(device.upload(dose), device.upload(target), threshold=2.0)
    assert got.threshold == 2.0
    assert got.iou == pytest.approx((into >= 2).sum() / (len(into) + (out >= 2).sum()), abs=1e-12)


def test_slices_share_one_scale_and_one_threshold(device: Device) -> None:
    dose, target = plain.example((33, 29, 21), 5, 0.1)
    fields = device.upload(dose), device.upload(target)
    whole = score(*fields)
    got = score_slices(*fields, whole)
    for z in range(dose.shape[2]):
        out, into = plain.split(dose[:, :, z : z + 1], target[:, :, z : z + 1])
        missing, excess = (into < whole.threshold).sum(), (out >= whole.threshold).sum()
        assert (got.in_voxels[z], got.missing[z], got.excess[z]) == (len(into), missing, excess)
        union = len(into) + excess
        assert got.iou[z] == pytest.approx((len(into) - missing) / union if union else 1.0, abs=1e-12)
        assert got.error_rate[z] == pytest.approx((missing + excess) / (len(out) + len(into)), abs=1e-12)
        if not len(into):
            assert np.isnan(got.window[z]) and np.isnan(got.trimmed[z]) and np.isnan(got.dose_range[z])
            continue
        assert got.window[z] == pytest.approx((into.min() - out.max()) / whole.peak, abs=1e-6)
        assert got.dose_range[z] == pytest.approx((into.max() - into.min()) / whole.peak, abs=1e-6)
        trimmed = np.quantile(into, 0.01, method="lower") - np.quantile(out, 0.99, method="higher")
        assert got.trimmed[z] == pytest.approx(trimmed / whole.peak, abs=1e-6)
    assert np.isnan(got.window).any()
    assert got.missing.sum() == whole.missing and got.excess.sum() == whole.excess


def test_scoring_the_whole_keeps_the_fields_on_the_device(fast_device: Device) -> None:
    dose, target = (fast_device.upload(a) for a in plain.example((32, 32, 40), 6, 0.1))
    with fast_device.no_transfers():
        score(dose, target)


@pytest.mark.parametrize("shape", SHAPES)
def test_dose_outside_over_inside(device: Device, shape: tuple[int, int, int]) -> None:
    dose, target = plain.example(shape, 3, 0.2)
    out, into = plain.split(dose, target)
    wanted = out.mean(dtype=np.float64) / into.mean(dtype=np.float64)
    field, part = device.upload(dose), device.upload(target)
    assert outside_over_inside(field, part) == pytest.approx(wanted, rel=1e-5)
    assert np.isnan(outside_over_inside(device.upload(np.zeros(shape)), part))


def test_light_that_floods_the_void_is_bright_and_yet_told(device: Device) -> None:
    """Even light is as bright as light can be, and gives the void as much as the part."""
    _, target = plain.example((24, 24, 8), 3, 0.0)
    even = device.upload(np.ones((6, 24, 8)))
    assert mean_brightness(even) == 1.0
    assert outside_over_inside(device.upload(np.ones((24, 24, 8))), device.upload(target)) == pytest.approx(1.0)
    assert outside_over_inside(device.upload(target >= 0.5), device.upload(target)) == 0.0


def test_mean_brightness_is_the_mean_over_the_greatest(device: Device) -> None:
    light = np.random.default_rng(0).random((19, 33, 21)).astype(np.float32) ** 4
    field = device.upload(light)
    assert mean_brightness(field) == pytest.approx(light.mean(dtype=np.float64) / light.max(), rel=1e-6)
    assert mean_brightness(field, full=2.0) == pytest.approx(light.mean(dtype=np.float64) / 2, rel=1e-6)
    assert mean_brightness(device.upload(np.zeros((2, 3, 4)))) == 0.0
    assert light_sent(field) == pytest.approx(light.sum(dtype=np.float64), rel=1e-6)


def test_wrong_input_is_refused(device: Device) -> None:
    field = device.upload(np.zeros((4, 4, 4)))
    with pytest.raises(ShapeMismatch, match=r"\(4, 4, 4\).*\(4, 4, 3\)"):
        Parts(field, device.upload(np.zeros((4, 4, 3))))
    with pytest.raises(BadInput, match="reach is -1"):
        Parts(field, field, reach=-1)
    with pytest.raises(BadInput, match="no voxel"):
        score(field, field)
    if device.name != "numpy":
        from vamgpu import open_device

        with pytest.raises(DeviceError, match="download it"):
            Parts(field, open_device("numpy").upload(np.zeros((4, 4, 4))))
