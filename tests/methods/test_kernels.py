"""Kernels of the optimizers do on every device what their NumPy definitions say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.kernels.filter import filter_rows, filtered_step
from vamgpu.kernels.loss import band_loss, ramp_loss, sampled_loss
from vamgpu.kernels.signature import Field, Kernel
from vamgpu.kernels.update import apply_penalty, correct_by_difference, correct_by_ratio, fill_background, linear
from vamgpu.operators.reductions import folded, parts_for

FLAT = np.array([0.0, 1.0])
CURVE = np.tanh(np.linspace(-1.0, 2.0, 40))
BAND = {
    "weighted": 0,
    "start": -1.0,
    "density": 13.0,
    "low": 0.2,
    "high": 0.9,
    "slack_low": 0.1,
    "slack_high": 0.05,
    "gain_low": 0.7,
    "gain_high": 1.3,
    "binary": 0,
    "reach": 15.0,
    "ridge": 0.0,
}
LINE = {"start": 0.0, "density": 1.0}
SUMS = ("parts", "slopes", "bends")
CASES: list[tuple[Kernel, dict[str, Any]]] = [
    (linear, {"a": 0.5, "b": -1.5, "floor": 0.0}),
    (apply_penalty, {"weight": 0.1, "power": 4.0, "hold": 0, "most": 1.0}),
    (apply_penalty, {"weight": 0.0, "power": 1.0, "hold": 1, "most": 1.0}),
    (fill_background, {"low": 0.6, "high": 1.0, "reach": 11.0}),
    (correct_by_ratio, {"scale": 1.2, "low": 0.6, "high": 1.0, "most": 3.0}),
    (
        correct_by_difference,
        {"scale": 1.1, "low": 0.3, "high": 0.9, "gain_outside": 1.0, "gain_inside": 0.5, "reach": 14.0},
    ),
    (filter_rows, {"taps": np.array([1.0, -0.4, 0.0, -0.05]), "stride": 2, "floor": 0.0}),
    (filter_rows, {"taps": np.array([1.0]), "stride": 1, "floor": -1e30}),
    (filtered_step, {"taps": np.linspace(1, -0.5, 90), "stride": 1, "step": 0.3, "momentum": 0.8}),
    (band_loss, {**BAND, **LINE, "response": FLAT, "power": 2.0}),
    (band_loss, {**BAND, "response": CURVE, "power": 3.0, "weighted": 1, "ridge": 0.2}),
    (band_loss, {**BAND, **LINE, "response": FLAT, "power": 1.0, "binary": 1}),
    *((sampled_loss, {"weighted": k, "outer": CURVE, "inner": CURVE[::-1] ** 2, "start": -1.0, "density": 13.0,
                      "binary": 1 - k, "reach": 15.0}) for k in (0, 1)),
    *((ramp_loss, {"weighted": k, "hold": 1 - k, "outside": 0.3, "inside": 0.8, "most": 0.9, "reach": 15.0})
      for k in (0, 1)),
]  # fmt: skip


def outcome(device: Device, kernel: Kernel, fixed: dict[str, Any]) -> list[np.ndarray]:
    """Everything the kernel writes on a device; partial results as their sum."""
    rng = np.random.default_rng(5)
    bound: dict[str, Any] = {}
    for argument, spec in kernel.arguments.items():
        if isinstance(spec, Field):
            values = rng.normal(size=(37, 30, 21))
            positive = argument in ("target", "weight") or kernel is correct_by_ratio
            bound[argument] = device.upload(np.float32(np.abs(values) if positive else values))
        elif argument in SUMS:
            bound[argument] = parts_for(kernel, bound[kernel.over])
        else:
            bound[argument] = device.table(fixed[argument]) if np.ndim(fixed[argument]) else fixed[argument]
    device.launch(kernel, **bound)
    written = [argument for argument, spec in kernel.arguments.items() if getattr(spec, "writes", False)]
    return [np.array(folded(bound[a])) if a in SUMS else bound[a].numpy() for a in written]


@pytest.mark.parametrize(("kernel", "fixed"), CASES, ids=lambda value: getattr(value, "name", ""))
def test_devices_follow_the_definition(fast_device: Device, kernel: Kernel, fixed: dict[str, Any]) -> None:
    reference = outcome(open_device("numpy"), kernel, fixed)
    for got, wanted in zip(outcome(fast_device, kernel, fixed), reference, strict=True):
        assert np.abs(got - wanted).max() <= 5e-6 * np.abs(wanted).max()
