"""Light of two levels: what driving it to its ends keeps, beside rounding, judged by the float64 reference."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.methods.part import fractions_of
from vamgpu.methods.two_levels import TwoLevels
from vamgpu.metrics import score

N, PITCH, ANGLES = 24, 0.1, 90


def ring() -> np.ndarray:
    x, y = np.meshgrid(*2 * [np.arange(N) - 0.5 * (N - 1)], indexing="ij")
    r = np.hypot(x, y)
    return ((r < 8.5) & (r > 4.5))[:, :, None].astype(np.float32)


def projection(device: Device | str, motion: vam.Turntable = vam.Turntable(ANGLES)) -> vam.Projection:
    grid, beam = vam.Grid((N, N, 1), PITCH), vam.Beam((34, 1), PITCH)
    return vam.Projection(grid, beam, motion, None, device)


@cache
def reference() -> vam.Projection:
    return projection("numpy")


def judged(light: np.ndarray) -> float:
    exact = reference()
    return float(score(exact.T(exact.device.upload(light.astype(np.float32))), exact.device.upload(ring())).window)


@pytest.mark.parametrize("black", [pytest.param(0.0, marks=pytest.mark.slow), 0.05])
def test_light_comes_to_have_two_levels_that_print(fast_device: Device, black: float) -> None:
    A = projection(fast_device)
    plan = vam.optimize(A, ring(), evaluations=40, progress=False)
    light = plan.sinogram.numpy()
    full = 5.0 * float(light.mean())
    levels = TwoLevels(A, fractions_of(A, plan.target), plan.sinogram)
    white = A.device.upload(np.full(light.shape, full, np.float32))
    apart, windows = [], []

    def rounded(found: np.ndarray) -> np.ndarray:
        return np.where(found > 0.5 * (1.0 + black) * full, full, black * full)

    for found in levels.seek(white):
        values = np.clip(found.numpy(), black * full, full)
        apart.append(float(np.abs(values - rounded(values)).mean() / full))
        windows.append(judged(rounded(values)))
    assert levels.possible and apart[0] > 0.06
    assert apart[-1] < 0.03, "it is driven to its ends"
    assert max(windows) > max(0.6 * plan.window, judged(rounded(light)) + 0.05)
    again = [judged(rounded(found.numpy())) for found in levels.seek(white)]
    assert again == pytest.approx(windows, abs=1e-3), "a search leaves nothing behind"
    assert np.array_equal(plan.sinogram.numpy(), light)


def test_light_that_cannot_be_split_is_told() -> None:
    A = projection("numpy", vam.Turntable(np.linspace(0.0, 5.0, ANGLES)))
    levels = TwoLevels(A, A.device.upload(ring()), A.device.upload(np.ones(A.range.shape, np.float32)))
    assert not levels.possible and not list(levels.seek(A.device.upload(np.ones(A.range.shape, np.float32))))
