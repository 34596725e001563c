"""Focus calibration on synthetic recordings: a blurred grating, a camera's noise, a lens of a known slope."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from vamgpu.calibration.focus import FocusLine, Peak, fit_peak, focus_line, lorentzian, tenengrad
from vamgpu.errors import BadInput
from vamgpu.optics.lens import TunableLens

LENS = TunableLens()
POSITIONS = np.arange(-4.0, 4.01, 1.0)
POWERS = np.linspace(7.0, 8.0, 41)
AXIS = 7.5
"""Power [dpt] that focuses on camera position 0."""


def recording(distance: np.ndarray, rng: np.random.Generator, photons: float = 400.0) -> np.ndarray:
    """Pictures [distance, row, column] of a square grating, out of focus by distances [mm], read as 8 bits.

    Lines of ten pixels; a blur of 1.2 pixels in focus and of √(1 + (d/1.9)²) that at a distance; photon and read noise.
    """
    rows, columns = 24, 80
    sigma = 1.2 * np.sqrt(1.0 + (distance / 1.9) ** 2)
    order = np.arange(1, 40, 2)
    x = np.arange(columns) + 0.3
    waves = np.sin(2.0 * np.pi * order[:, None] * x / 20.0) * (2.0 / (np.pi * order[:, None]))
    damped = np.exp(-0.5 * (2.0 * np.pi * order / 20.0 * sigma[:, None]) ** 2)
    light = 0.5 + 0.9 * damped @ waves
    photon = photons * np.clip(np.repeat(light[:, None, :], rows, axis=1), 0.02, None)
    return np.clip(np.round(200.0 * (rng.poisson(photon) + rng.normal(0.0, 3.0, photon.shape)) / photons), 0, 255)


def stacks(slope: float, seed: int, photons: float = 400.0) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(seed)
    for position in POSITIONS:
        yield recording(position - slope * (POWERS - AXIS), rng, photons).astype(np.uint8)


def line_through(taken: Iterable[np.ndarray]) -> FocusLine:
    """The line of focus, from pictures [power, row, column] at each position."""
    return focus_line(POSITIONS, [fit_peak(POWERS, tenengrad(pictures)) for pictures in taken])


@pytest.mark.parametrize("seed", range(12))
def test_the_slope_is_found_within_one_percent(seed: int) -> None:
    line = line_through(stacks(LENS.slope, seed))
    assert line.slope == pytest.approx(LENS.slope, rel=0.01)
    assert abs(line.slope - LENS.slope) < 5 * line.error < 0.05 * abs(LENS.slope)
    assert line.power(0.0) == pytest.approx(AXIS, abs=0.005)
    assert len(line.peaks) == POSITIONS.size


@pytest.mark.slow
def test_errors_hold_the_truth_as_often_as_they_say() -> None:
    """The sweep reaches farther on one side of most peaks, and a blurred grating's sharpness is no Lorentzian."""
    lines = [line_through(stacks(LENS.slope, seed, 40_000.0)) for seed in range(100, 124)]
    slopes = np.array([(line.slope - LENS.slope) / line.error for line in lines])
    truth = AXIS + POSITIONS / LENS.slope
    found = np.array([[(peak.power, peak.error) for peak in line.peaks] for line in lines])
    powers = (found[..., 0] - truth) / found[..., 1]
    assert (np.abs(slopes) < 2.0).mean() >= 0.9
    assert max(line.error for line in lines) < 0.003 * abs(LENS.slope)
    assert (np.abs(powers) < 2.0).mean() >= 0.9


def test_without_noise_the_fit_is_exact() -> None:
    powers = np.linspace(5.0, 7.0, 30)
    peak = fit_peak(powers, lorentzian(powers, 6.1, 0.2, 50.0, 3.0))
    assert (peak.power, peak.width, peak.height, peak.floor) == pytest.approx((6.1, 0.2, 50.0, 3.0), rel=1e-6)
    np.testing.assert_allclose(peak(powers), lorentzian(powers, 6.1, 0.2, 50.0, 3.0), rtol=1e-6)


def test_a_peaks_error_is_what_its_scatter_makes_it() -> None:
    powers = np.linspace(5.0, 7.0, 60)
    clean = lorentzian(powers, 6.1, 0.2, 50.0, 3.0)
    peaks: list[Peak] = [fit_peak(powers, clean + np.random.default_rng(s).normal(0, 2.0, 60)) for s in range(60)]
    assert np.std([peak.power for peak in peaks]) == pytest.approx(np.mean([peak.error for peak in peaks]), rel=0.3)
    assert np.mean([peak.scatter for peak in peaks]) == pytest.approx(2.0, rel=0.1)


def test_tenengrad_is_the_sobel_gradient() -> None:
    from scipy.ndimage import sobel

    picture = np.random.default_rng(1).random((2, 9, 11))
    squared = np.array([sobel(one, axis=0) ** 2 + sobel(one, axis=1) ** 2 for one in picture])
    wanted = squared[:, 1:-1, 1:-1].mean(axis=(1, 2))
    np.testing.assert_allclose(tenengrad(picture), wanted, rtol=1e-12)
    assert tenengrad(np.full((5, 5), 200, np.uint8)) == 0.0


def test_what_has_no_peak_is_refused_with_numbers() -> None:
    rng = np.random.default_rng(2)
    powers = np.linspace(7.0, 8.0, 41)
    with pytest.raises(BadInput, match="equally sharp, 2"):
        fit_peak(powers, np.full(41, 2.0))
    with pytest.raises(BadInput, match="outside the powers 7 to 8 dpt|no peak fits"):
        fit_peak(powers, lorentzian(powers, 8.4, 0.5, 1.0, 0.0))
    refused = 0
    for _ in range(100):
        try:
            fit_peak(powers, rng.normal(5.0, 1.0, 41))
        except BadInput:
            refused += 1
    assert refused >= 98
    with pytest.raises(BadInput, match="took 3 powers; expected 6"):
        fit_peak([1.0, 2.0, 3.0], [1.0, 2.0, 1.0])
    with pytest.raises(BadInput, match="one for each"):
        fit_peak(powers, np.ones(4))


def test_bad_recordings_are_refused() -> None:
    flat = np.full((41, 8, 8), 90, np.uint8)
    with pytest.raises(BadInput, match="all pictures"):
        line_through([flat] * 9)
    with pytest.raises(BadInput, match="two or more different"):
        focus_line([1.0, 1.0], [Peak(7.5, 0.1, 1.0, 0.0, 0.01, 0.0)] * 2)
    with pytest.raises(BadInput, match="3 × 3"):
        tenengrad(np.zeros((4, 2, 9)))
    with pytest.raises(BadInput, match="not finite"):
        tenengrad(np.full((4, 4), np.nan))
