"""The stationary state in closed form, against the drift it is the zero of."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.phase_plane import drift, nullcline, stationary
from vamgpu.chemistry.species import LightCycle, Rates, SpeciesState
from vamgpu.errors import BadInput

RATES = Rates(0.1, 0.06, 0.2, 0.05, supply=40.0, order=0)


@pytest.mark.parametrize("order", [0, 1])
def test_state_jacobian_and_eigenvalues(order: int) -> None:
    rates = Rates(0.1, 0.06, 0.2, 0.05, supply=40.0, order=order)
    visible, uv = 0.8, 0.5
    found = stationary(rates, visible, uv)
    assert found
    assert np.abs(drift(rates, 0.0, found.b, visible, uv)[:2]).max() < 1e-15
    step = 1e-5
    columns = []
    for a, b in ((step, 0.0), (0.0, step)):
        ahead = np.array(drift(rates, 2 * a, found.b + b, visible, uv)[:2])
        behind = np.array(drift(rates, 0.0, found.b - b, visible, uv)[:2])
        columns.append((ahead - behind) / (2 * step))
    np.testing.assert_allclose(found.jacobian, np.array(columns).T, rtol=1e-3, atol=1e-9)
    # eqs 9 and 10
    a, surplus = rates.k_a * visible, 2 * rates.k_c * uv - rates.k_b * visible
    assert found.eigenvalues.prod() == pytest.approx(4 * rates.k_2 * a)
    total = -a * np.sqrt(2 * rates.k_2 / surplus) - 2 * np.sqrt(2 * rates.k_2 * surplus)
    assert found.eigenvalues.sum() == pytest.approx(total)
    assert (found.eigenvalues < 0).all()
    np.testing.assert_allclose(found.eigenvalues, np.sort(np.linalg.eigvals(found.jacobian).real))


def test_it_exists_only_for_enough_uv() -> None:
    edge = 0.5 * RATES.alpha
    for beta in (0.5 * edge, edge, 1.01 * edge):
        uv = beta * RATES.k_a * 0.7 / RATES.k_c
        assert RATES.beta(0.7, uv) == pytest.approx(beta)
        assert (stationary(RATES, 0.7, uv) is not None) == (beta > edge * (1 + 1e-12))
    with pytest.raises(BadInput, match="k_2 is 0"):
        stationary(Rates(0.1, 0.1, 1.0, 0.0), 1.0, 1.0)


def test_every_start_ends_there() -> None:
    found = stationary(RATES, 1.0, 0.5)
    assert found
    starts = SpeciesState([1.0, 0.2, 0.7], [0.0, 2.0, 0.1], 40.0)
    course = advance(RATES, starts, LightCycle(1.0, 0.5, 40 * found.slowest), device="numpy")
    np.testing.assert_allclose(course.b, found.b, rtol=1e-4)
    assert course.a.max() < 1e-4 and not course.depleted.any()


def test_drift_at_the_origin_and_along_the_nullcline() -> None:
    assert all(value == 0.0 for value in drift(RATES, 0.0, 0.0, 1.0, 0.5))
    b = np.linspace(0.01, 1.5, 40)
    a = nullcline(RATES, b, 1.0, 0.12)
    there = np.isfinite(a)
    assert 3 < there.sum() < b.size
    assert np.abs(drift(RATES, a[there], b[there], 1.0, 0.12)[1]).max() < 1e-15
    with pytest.raises(BadInput, match=r"\[B\]"):
        drift(RATES, 1.0, -1.0, 1.0, 1.0)


def test_the_ratio_of_sensitivities() -> None:
    assert RATES.alpha == pytest.approx(0.6)
