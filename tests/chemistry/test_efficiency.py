"""Efficiency of UV against its exact values, its trends in a turning vial, and the four measured induction times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.chemistry.efficiency import RotatingLight, efficiency_at, exact_efficiency, uv_needed
from vamgpu.chemistry.induction import MEASURED, fit_induction, induction_times
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.species import LightCycle, Rates, SpeciesState
from vamgpu.errors import BadInput

RATES = Rates(1.0, 1.0, 1.0, 0.02, supply=50.0, order=0)
LIGHT = RotatingLight(visible=0.05, uv=0.01, visible_extinction=0.02, uv_extinction=0.06, poses=36)
RADII = np.array([0.0, 5.0, 10.0, 14.5])
PHASES = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)


def spread(rates: Rates = RATES, light: RotatingLight = LIGHT) -> np.ndarray:
    """W, (radii, phases)."""
    radius, phase = (v.ravel() for v in np.meshgrid(RADII, PHASES, indexing="ij"))
    return efficiency_at(rates, light, radius, phase, device="numpy")[0].reshape(RADII.size, PHASES.size)


@pytest.mark.parametrize(("alpha", "beta", "stored"), [(1.0, 0.25, 0.0), (0.5, 0.1, 0.0), (2.0, 0.0, 0.6),
                                                       (0.4, 0.0, 0.3), (1.5, 0.3, 0.4)])  # fmt: skip
def test_exact_values_along_the_equations(device: Device, alpha: float, beta: float, stored: float) -> None:
    k_a = 0.05
    rates = Rates(k_a, alpha * k_a, beta * k_a, 0.0, supply=30.0, order=0)
    course = advance(rates, SpeciesState(1.0, stored, 30.0), LightCycle(1.0, 1.0, 400.0), device=device)
    exact = exact_efficiency(alpha, beta, stored)
    assert course.efficiency[0, 0] == pytest.approx(exact, abs=2e-5)
    assert course.event[0, 0] == pytest.approx((1.0 + exact) / k_a, rel=1e-4)


def test_exact_values() -> None:
    assert exact_efficiency(1.0, 0.25) == pytest.approx(1.0)
    assert exact_efficiency(0.8, 0.0, 0.4) == pytest.approx(0.5)
    assert exact_efficiency(1.0, 0.5) == np.inf and exact_efficiency(1.0, 0.7) == np.inf
    assert exact_efficiency(1.0) == 0.0
    rates = Rates(0.05, 0.05, 0.026, 0.0, supply=99.0, order=0)
    never = advance(rates, SpeciesState(1.0, 0.0, 99.0), LightCycle(1.0, 1.0, 1e3), device="numpy")
    assert not never.depleted.any()


def test_one_point_in_a_turning_vial_sees_the_whole_turn() -> None:
    """Equal extinctions and no pairing: β is the same at every pose, so W is that of constant light."""
    light = replace(LIGHT, uv_extinction=LIGHT.visible_extinction)
    w = spread(replace(RATES, k_2=0.0), light)
    np.testing.assert_allclose(w, exact_efficiency(1.0, 0.2), atol=1e-5)
    way = light.path([7.0], [0.3])
    assert way.max() <= light.vial + 7.0 and way.min() >= light.vial - 7.0
    across = 7.0 * np.sin(0.3 - 2 * np.pi * (np.arange(36) + 0.5) / 36)
    np.testing.assert_allclose(way + np.roll(way, 18, axis=1), 2 * np.sqrt(15.0**2 - across**2)[None])


def test_negativity_falls_towards_the_axis_and_the_rim_feels_rotation_most() -> None:
    w = spread()
    assert (np.diff(w.mean(axis=1)) > 0).all()
    ripple = np.ptp(w, axis=1)
    assert ripple[0] < 1e-5 and (np.diff(ripple) > 0).all()


def test_more_extinction_or_a_shorter_life_lowers_it() -> None:
    by_extinction = [spread(light=replace(LIGHT, uv_extinction=mu)).mean(axis=1) for mu in (0.02, 0.06, 0.1)]
    assert (np.diff(by_extinction, axis=0) < 0).all()
    by_life = [spread(replace(RATES, k_2=k_2)).mean(axis=1) for k_2 in (0.0, 0.02, 0.2)]
    assert (np.diff(by_life, axis=0) < 0).all()


def test_uv_for_twice_the_induction(fast_device: Device) -> None:
    irradiance, dose = uv_needed(RATES, LIGHT, RADII, device=fast_device)
    for uv, radius in zip(irradiance, RADII, strict=True):
        w = efficiency_at(RATES, replace(LIGHT, uv=float(uv)), radius, device=fast_device)
        assert w[0, 0] == pytest.approx(1.0, abs=1e-3)
    assert (np.diff(dose) < 0).all(), "the axis asks for the most"
    steady = RotatingLight(visible=0.05, visible_extinction=0.0, uv_extinction=0.0, poses=4)
    needed, spent = uv_needed(replace(RATES, k_2=0.0), steady, [0.0], device=fast_device)
    assert needed[0] == pytest.approx(0.25 * 0.05, rel=1e-3)
    assert spent[0] == pytest.approx(0.25 * 0.05 * 40.0, rel=1e-3)
    with pytest.raises(BadInput, match="do not reach"):
        uv_needed(replace(RATES, supply=0.1), LIGHT, RADII, device=fast_device)


def test_constants_of_the_four_induction_times(processor: str) -> None:
    found = fit_induction(device=processor)
    assert found.times[0] == pytest.approx(30.0, rel=1e-4)
    assert found.rms < 0.8, "39.1, 49.2 and 68.0 s are known to be reachable"
    assert max(abs(error) for error in found.errors) < 1.2
    np.testing.assert_allclose(found.times, induction_times([found.rates], "numpy")[0], rtol=1e-4)
    assert found.measured == MEASURED


def test_bad_input_is_named() -> None:
    with pytest.raises(BadInput, match="expected 0 … 15 mm"):
        LIGHT.at([16.0])
    with pytest.raises(BadInput, match="visible .* is 0"):
        RotatingLight(visible=0.0)
    with pytest.raises(BadInput, match="normalized"):
        induction_times([Rates(1.0, 1.0, 1.0, 1.0, oxygen=2.0)])
    with pytest.raises(BadInput, match="the shortest"):
        fit_induction((30.0, 20.0, 40.0, 50.0), device="numpy")
