"""Parameters of a print, found again in doses that another operator made, with errors as great as they are said."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import vamgpu
from vamgpu.chemistry.history import ResinHistory
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.live import Estimator, Prior, estimate
from vamgpu.live.prior import NAMES, NOMINAL
from vamgpu.losses.response import GeneralizedLogistic
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.printing.scenarios import clouded, displaced

TRUE = np.array([0.85, 1.15, 0.05, 0.0, 0.05, 0.0, 0.0])
NOISE = 0.04


@cache
def setup() -> tuple[Estimator, np.ndarray, np.ndarray]:
    """An estimator, light, and the dose that a machine off by `TRUE` gives: by traced rays, on finer voxels."""
    grid = Grid((28, 28, 16), 0.1)
    vial = Vial(8.0, 0.5, 1.5, 1.5, 1.0, absorption=0.3)
    A = Projection(grid, Beam((60, 16), 0.1), Turntable(60), vial, device=vamgpu.open_device())
    x, y, z = np.meshgrid(*grid.axes(), indexing="ij")
    part = (np.hypot(x, 0.7 * y) < 0.8) & (np.abs(z) < 0.55) & ~(np.hypot(x - 0.2, y) < 0.3)
    light = np.asarray(A(part.astype(np.float32)))
    light *= 0.8 / np.asarray(A.T(light))[part].mean()
    estimator = Estimator(A, GeneralizedLogistic(steepness=6.0, middle=0.6))
    off = IndependentExposure(displaced(clouded(A, TRUE[1] - 1.0), TRUE[2] / 0.1))
    even = np.asarray(off.averaged(A.device.upload(light))[0], float)
    return estimator, light, even * estimator.gain(TRUE).numpy()


def seen(seed: int) -> np.ndarray:
    estimator, _, dose = setup()
    return estimator.conversion(dose) + NOISE * np.random.default_rng(seed).standard_normal(dose.shape)


def test_parameters_lie_within_two_standard_errors_as_often_as_promised() -> None:
    estimator, light, dose = setup()
    found = [estimator.estimate(light, seen(seed), NOISE, Prior.of()) for seed in range(5)]
    errors = np.array([(e.values - TRUE) / np.sqrt(np.diag(e.covariance)) for e in found])
    assert np.mean(np.abs(errors) < 2.0) >= 0.9
    first = found[0]
    assert first.parameters["across"] == pytest.approx((0.05, 0.0), abs=0.01)
    assert first.parameters["sensitivity"][1] < 0.2 and abs(first.chi_square / first.voxels - 1.0) < 0.1
    np.testing.assert_allclose(np.diag(first.correlation), 1.0)
    within = estimator.operator.grid.cylinder()[:, :, None] & (dose > 0.2)
    rms = np.sqrt(np.mean((first.dose - dose)[within] ** 2))
    assert rms < 0.02 and 0.3 < rms / np.sqrt(np.mean(first.deviation[within] ** 2)) < 1.5


def test_errors_widen_where_noise_was_told_too_small() -> None:
    """Told a third of it, errors stay those of the noise that is there; told three times as much, they are three times
    as wide where images tell more than what was known before."""
    estimator, light, _ = setup()
    told, less, more = (estimator.estimate(light, seen(0), share * NOISE, Prior.of()) for share in (1.0, 1 / 3, 3.0))
    assert less.chi_square / less.voxels == pytest.approx(9.0, rel=0.1)
    errors = np.sqrt([np.diag(one.covariance)[:6] for one in (told, less, more)])
    np.testing.assert_allclose(errors[1] / errors[0], 1.0, rtol=0.2)
    assert (np.abs(less.values - TRUE)[:6] < 2.0 * errors[1]).all()
    places = [NAMES.index(name) for name in ("across", "height", "along_z")]
    np.testing.assert_allclose(errors[2, places] / errors[0, places], 3.0, rtol=0.2)


def test_derivatives_of_the_dose_are_those_of_the_real_operator() -> None:
    estimator, light, _ = setup()
    used = np.arange(light.size)[: estimator.operator.grid.shape[0] ** 2 * 16]
    near = estimator._near(estimator.operator.device.field(light), NOMINAL, used)
    for index, step in ((0, 0.01), (1, 0.02), (2, 0.003), (3, 0.01), (4, 0.01), (5, 0.01)):
        ends = [estimator.calibrated(NOMINAL + side * step * (np.arange(7) == index)).T(light) for side in (-1, 1)]
        real = (np.asarray(ends[1], float) - np.asarray(ends[0], float)).reshape(-1) / (2.0 * step)
        scale = np.abs(real).max()
        assert np.sqrt(np.mean((near.rates(NOMINAL)[index] - real) ** 2)) < 0.02 * scale, NAMES[index]


def test_resin_that_has_had_some_dose_is_told_from_a_stronger_lamp() -> None:
    estimator, light, dose = setup()
    conversion = estimator.conversion(dose + 0.2)
    conversion += NOISE * np.random.default_rng(0).standard_normal(dose.shape)
    found = estimator.estimate(light, conversion, NOISE, Prior.of(None, {"initial_dose": 0.3}))
    value, deviation = found.parameters["initial_dose"]
    assert value == pytest.approx(0.2, abs=3.0 * deviation) and deviation < 0.05
    within = estimator.operator.grid.cylinder()
    assert np.sqrt(np.mean((found.dose - dose - 0.2)[within] ** 2)) < 0.02
    with pytest.raises(BadInput, match="impossible for a print"):  # by six parameters, all of them wrong
        estimator.estimate(light, conversion, NOISE, Prior.of())


def test_slices_have_the_dose_of_the_whole_and_some_tell_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    estimator, light, _ = setup()
    taken = Projection(Grid((28, 28, 12), 0.1), Beam((60, 16), 0.12), Turntable(60), estimator.operator.vessel)
    rows = light @ taken.row_weights[[2, 7]].T.astype(np.float32)
    whole = np.asarray(taken.T(light))
    np.testing.assert_allclose(taken.lit_slices(rows).numpy(), whole[..., [2, 7]], atol=1e-5 * whole.max())
    monkeypatch.setattr(estimate, "SLICES", 6)
    assert np.unique(estimator._slices(light)).size == 6
    few = estimator.estimate(light, seen(0), NOISE, Prior.of())
    assert few.voxels < 0.4 * light[0, 0].size * 28 * 28
    assert np.mean(np.abs(few.values - TRUE) < 2.0 * np.sqrt(np.diag(few.covariance))) > 0.8


def test_operators_are_made_once_for_turns_that_are_alike() -> None:
    estimator, light, dose = setup()
    estimator = Estimator(estimator.operator, estimator.response)
    found = estimator.estimate(light, seen(0), NOISE, Prior.of())
    made = estimator._placed.cache_info().misses
    again = estimator.estimate(1.1 * light, estimator.conversion(1.1 * dose), NOISE, Prior.of(), start=found.values)
    assert estimator._placed.cache_info().misses <= made + 1, "that of the dose alone"
    assert (np.abs(again.values - TRUE) < 3.0 * np.sqrt(np.diag(again.covariance))).all()


@pytest.mark.parametrize("value", [np.nan, 0.0])
def test_nonsense_is_refused(value: float) -> None:
    estimator, light, dose = setup()
    with pytest.raises(BadInput, match="drop this turn's images|impossible for a print"):
        estimator.estimate(light, np.full(dose.shape, value), 0.01, Prior.of())


@pytest.mark.parametrize("start", [np.ones(6), np.full(7, np.nan)])
def test_a_start_is_a_value_for_each_parameter(start: np.ndarray) -> None:
    estimator, light, _ = setup()
    with pytest.raises(BadInput, match="expected 7 finite values"):
        estimator.estimate(light, seen(0), NOISE, Prior.of(), start=start)


def test_a_vial_gives_the_prior() -> None:
    used = ResinHistory("resin", 20.0, oxygen=0.8)
    prior = Prior.of(used, {"absorption": 0.05})
    assert prior.mean[0] == pytest.approx(1.25) and prior.covariance[1, 1] == pytest.approx(0.0025)
    with pytest.raises(BadInput, match="expected names"):
        Prior.of(deviations={"age": 1.0})
