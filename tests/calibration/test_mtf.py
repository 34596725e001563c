"""The modulation behind a slanted edge against that of the blur it was made with, and pictures that tell none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from vamgpu.calibration.mtf import slanted_edge
from vamgpu.errors import BadInput

PIXEL = 0.0078
INSIDE = 5
"""Samples within a camera's pixel."""


def edge(
    blur: float, angle: float = 5.0, noise: float = 0.0, shape: tuple[int, int] = (104, 208), seed: int = 3
) -> np.ndarray:
    """An edge with a Gaussian blur [pixels], seen by pixels that are as wide as their pitch."""
    row, column = np.meshgrid(
        np.arange(shape[0]) - 0.5 * (shape[0] - 1), (np.arange(shape[1] * INSIDE) + 0.5) / INSIDE - 0.5, indexing="ij"
    )
    tilt = np.radians(angle)
    light = ndtr((column - 0.49 * shape[1] - np.tan(tilt) * row) * np.cos(tilt) / blur)
    picture = 200.0 + 4000.0 * light.reshape(*shape, INSIDE).mean(axis=2)
    return picture + noise * np.random.default_rng(seed).standard_normal(shape)


def truth(frequency: np.ndarray, blur: float, angle: float) -> np.ndarray:
    """Of the blur and of a pixel's width across the edge; ``frequency`` in cycles/mm."""
    f = frequency * PIXEL
    return np.exp(-2.0 * (np.pi * blur * f) ** 2) * np.sinc(f * np.cos(np.radians(angle)))


def half(blur: float, angle: float) -> float:
    f = np.linspace(0.0, 0.5, 200001) / PIXEL
    return float(f[np.argmax(truth(f, blur, angle) < 0.5)])


@pytest.mark.parametrize("blur", [0.9, 1.7, 5.0, 14.0])
@pytest.mark.parametrize("angle", [5.0, -8.0])
def test_modulation_is_that_of_the_blur(blur: float, angle: float) -> None:
    found = slanted_edge(edge(blur, angle), PIXEL)
    assert np.abs(found.modulation - truth(found.frequency, blur, angle)).max() < 0.01
    assert found.half == pytest.approx(half(blur, angle), rel=0.01)
    assert found.angle == pytest.approx(angle, abs=0.01)
    assert found.width == pytest.approx(np.hypot(blur, 1.0 / np.sqrt(12.0)) * PIXEL, rel=0.02)
    assert found.contrast == pytest.approx(4000.0 / 4400.0, rel=0.01)
    assert found.modulation[0] == 1.0 and found.frequency[-1] == pytest.approx(0.5 / PIXEL)


@pytest.mark.parametrize("blur", [1.7, 5.0, 14.0])
def test_noise_of_a_camera_is_borne(blur: float) -> None:
    found = slanted_edge(edge(blur, noise=60.0), PIXEL)
    assert found.half == pytest.approx(half(blur, 5.0), rel=0.015)


@pytest.mark.parametrize("blur", [1.7, 5.0])
def test_errors_hold_the_truth_as_often_as_they_say(blur: float) -> None:
    """Within two standard errors lie 95 % of all; the pixel's own width counts to the blur."""
    found = [slanted_edge(edge(blur, noise=150.0, shape=(48, 96), seed=seed), PIXEL) for seed in range(24)]
    truth = np.hypot(blur, 1.0 / np.sqrt(12.0)) * PIXEL
    pulls = [(each.width - truth) / each.width_error for each in found]
    assert (np.abs(pulls) < 2.0).mean() >= 0.87 and 0.6 < np.std(pulls) < 1.4


def test_an_edge_may_lie_along_rows_and_fall() -> None:
    upright = slanted_edge(edge(3.0), PIXEL)
    for turned in (edge(3.0).T, edge(3.0)[:, ::-1], edge(3.0)[::-1].T):
        assert slanted_edge(turned, PIXEL).half == pytest.approx(upright.half, rel=1e-3)


def test_pictures_without_a_usable_edge_are_told() -> None:
    noise = 100.0 + np.random.default_rng(0).standard_normal((64, 64))
    for picture, why in (
        (noise, "with a noise of"),
        (np.full((64, 64), 7.0), "expected an edge"),
        (edge(2.0, angle=0.3), "turn the camera or the edge"),
        (edge(60.0), "use a wider view"),
        (edge(0.2, noise=0.0), "move the camera closer"),
        (np.zeros(9), "expected \\[row, column\\]"),
        (np.full((64, 64), np.nan), "not finite"),
    ):
        with pytest.raises(BadInput, match=why):
            slanted_edge(picture, PIXEL)
    with pytest.raises(BadInput, match="pixel"):
        slanted_edge(edge(2.0), 0.0)
