"""Photoinhibition kinetics against SciPy, closed forms, conservation laws, and across devices."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vamgpu.backend.device import Device
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.species import LightCycle, Rates, SpeciesState
from vamgpu.errors import BadInput

SECONDS = 100.0


def resins(count: int = 12) -> list[Rates]:
    """Rates of both orders over one and a half decades each, [A] before printing being 1."""
    rng = np.random.default_rng(7)
    k_a = 1.0 / 30.0
    alpha, beta = 10 ** rng.uniform(-1.0, 0.7, count), 10 ** rng.uniform(-1.5, 0.7, count)
    k_2 = 10 ** rng.uniform(-4.0, 0.5, count)
    return [Rates(k_a, k_a * x, k_a * y, z, supply=8.0, order=n % 2)
            for n, (x, y, z) in enumerate(zip(alpha, beta, k_2, strict=True))]  # fmt: skip


STARTS = SpeciesState([1.0, 1.0, 0.4], [0.0, 0.3, 0.0], 8.0)
STEADY = LightCycle(1.0, 1.0, SECONDS)


def by_scipy(rates: Rates, start: tuple[float, ...], light: tuple[float, float], seconds: float) -> tuple:
    """State at the end or at the event, and the time of the event or NaN, of eqs 5–7 with C never used up."""
    visible, uv = light

    def change(_: float, y: np.ndarray) -> list[float]:
        a, b, c = y
        split = rates.k_c * uv * (c / rates.supply if rates.order else 1.0)
        paired = rates.k_2 * b * b
        return [-rates.k_a * visible * a / (a + b), -rates.k_b * visible * b / (a + b) + 2 * (split - paired),
                paired - split]  # fmt: skip

    def depleted(_: float, y: np.ndarray) -> float:
        return y[0] + y[1] - 1e-6 * rates.oxygen

    depleted.terminal = True  # type: ignore[attr-defined]
    found = solve_ivp(change, (0.0, seconds), start, "Radau", events=depleted, rtol=1e-10, atol=1e-13)
    assert found.success
    end, event = found.y[:, -1].copy(), found.t_events[0]
    if event.size:
        end[:2] = 0.0
    return end, event[0] if event.size else np.nan


@cache
def wanted() -> tuple[np.ndarray, np.ndarray]:
    runs = [by_scipy(rates, tuple(row), (1.0, 1.0), SECONDS) for rates in resins() for row in STARTS.table]
    shape = (len(resins()), len(STARTS))
    return np.array([end for end, _ in runs]).reshape(*shape, 3), np.array([t for _, t in runs]).reshape(shape)


@pytest.mark.slow
def test_states_and_events_are_those_of_a_fine_integration(device: Device) -> None:
    ends, events = wanted()
    course = advance(resins(), STARTS, STEADY, device=device)
    found = np.stack([course.a, course.b, course.c], axis=-1)
    np.testing.assert_array_equal(course.depleted, np.isfinite(events))
    assert 0.2 < course.depleted.mean() < 0.8
    assert np.abs(found - ends).max() < 1e-4
    assert np.nanmax(np.abs(course.event - events) / events) < 1e-4


@pytest.mark.slow
def test_short_intervals_lead_to_the_same_place(device: Device) -> None:
    ends, events = wanted()
    course = advance(resins(), STARTS, LightCycle(1.0, 1.0, [1.0]), intervals=100, rows=5, device=device)
    assert np.abs(np.stack([course.a, course.b, course.c], axis=-1) - ends).max() < 1e-4
    assert np.nanmax(np.abs(course.event - events) / events) < 1e-4
    middle = advance(resins(), STARTS, LightCycle(1.0, 1.0, 50.0), device=device)
    assert np.abs(course.path[:, :, 2, :3] - np.stack([middle.a, middle.b, middle.c], axis=-1)).max() < 1e-4
    np.testing.assert_allclose(course.path[:, :, -1, 3], course.dose, rtol=1e-6)


def test_devices_agree(fast_device: Device) -> None:
    rng = np.random.default_rng(1)
    light = LightCycle(rng.uniform(0.2, 2.0, (3, 5)), rng.uniform(0.0, 1.0, (3, 5)), [3.0, 5.0, 1.0, 8.0, 2.0])
    first, second = (advance(resins(), STARTS, light, intervals=23, first=2, device=d) for d in (fast_device, "numpy"))
    for name in ("a", "b", "c", "dose", "event", "efficiency"):
        values, exact = getattr(first, name), getattr(second, name)
        np.testing.assert_allclose(values, exact, rtol=0, atol=2e-5 * np.nanmax(np.abs(exact)), err_msg=name)


def test_what_is_lost_has_been_absorbed(device: Device) -> None:
    """[B] + 2[C] + α[A] falls by k_B times the visible dose, in light and dark, with C left or not."""
    light = LightCycle([1.0, 0.0, 0.5, 1.0], [2.0, 1.0, 0.0, 3.0], [4.0, 3.0, 7.0, 2.0])
    for supply in (8.0, 0.3):
        start = SpeciesState(np.asarray(STARTS.a), STARTS.b, supply)
        several = [Rates(r.k_a, r.k_b, r.k_c, r.k_2, supply=supply, order=r.order) for r in resins()]
        course = advance(several, start, light, intervals=40, rows=41, device=device)
        alpha, k_b = (np.array([getattr(r, name) for r in several])[:, None, None] for name in ("alpha", "k_b"))
        a, b, c, dose = np.moveaxis(course.path, -1, 0)
        assert min(a.min(), b.min(), c.min()) >= 0.0
        held = b + 2.0 * c + alpha * a + k_b * dose
        assert np.abs(held - held[:, :, :1]).max() < 3e-5


def test_used_up_supply_stays_at_zero_and_stops_making_lophyl() -> None:
    rates = Rates(1 / 30, 0.02, 0.1, 0.05, supply=0.2, order=0)
    course = advance(
        rates, SpeciesState(1.0, 0.0, 0.2), LightCycle(1.0, 1.0, [0.5]), intervals=60, rows=61, device="numpy"
    )
    a, b, c, _ = course.path[0, 0].T
    assert c.min() == 0.0 and c[6] == 0.0 and c[2] > 0.0
    share = b / np.maximum(a + b, 1e-9)
    slope = np.diff(b)[10:40] / 0.5
    np.testing.assert_allclose(slope, -0.02 * 0.5 * (share[10:40] + share[11:41]), rtol=2e-3)


def test_the_origin_is_kept_and_zero_over_zero_is_nothing(device: Device) -> None:
    rates = Rates(0.1, 0.05, 0.2, 0.1, supply=1.0)
    starts = SpeciesState([0.0, 1e-7, 1.0], [0.0, 0.0, 0.0], 1.0)
    course = advance(rates, starts, LightCycle(1.0, [0.0, 1.0], [20.0, 50.0]), device=device)
    assert course.event[0, 0] == 0.0 and course.event[0, 1] == 0.0
    assert course.event[0, 2] == pytest.approx(10.0, rel=1e-5)
    assert not course.a.any() and not course.b.any() and (course.c == 1.0).all()
    assert np.isnan(course.efficiency[0, 0])


def test_stiff_resins_settle_at_their_stationary_state(device: Device) -> None:
    """Time constants of 1 µs … 10 s followed for 10,000 s."""
    several = [Rates(0.1, 0.05, k_c, k_2, supply=400.0, order=0) for k_c in (0.02501, 0.1, 30.0) for k_2 in (1e-2, 1e4)]
    course = advance(several, SpeciesState(1.0, 0.0, 400.0), LightCycle(1.0, 1.0, [1e4]), device=device)
    for n, rates in enumerate(several):
        level = np.sqrt((2 * rates.k_c - rates.k_b) / (2 * rates.k_2))
        if level > 1e-3:
            assert course.b[n, 0] == pytest.approx(level, rel=2e-3)


def test_pairing_in_the_dark_is_second_order(device: Device) -> None:
    course = advance(
        Rates(0.1, 0.1, 0.1, 0.02), SpeciesState(1.0, 3.0, 1.0), LightCycle(0.0, 0.0, [40.0]), device=device
    )
    assert course.b[0, 0] == pytest.approx(3.0 / (1.0 + 2 * 0.02 * 3.0 * 40.0), rel=1e-5)
    assert course.a[0, 0] == 1.0 and course.dose[0, 0] == 0.0


@pytest.mark.parametrize(("make", "told"), [
    (lambda: SpeciesState(-0.1, 0.0, 1.0), r"\[A\] is -0.1"),
    (lambda: SpeciesState(1.0, float("nan"), 1.0), r"\[B\] has shape .* 1 numbers that are not finite"),
    (lambda: SpeciesState([1.0, 1.0], [0.0, 0.0, 0.0], 1.0), "expected one length"),
    (lambda: Rates(0.1, -0.1, 0.1, 0.1), "k_b is -0.1"),
    (lambda: Rates(0.1, 0.1, float("inf"), 0.1), "k_c is inf"),
    (lambda: Rates(0.1, 0.1, 0.1, 0.1, order=2), "order is 2"),
    (lambda: Rates(0.1, 0.1, 0.1, 0.1, supply=0.0), "supply of 0"),
    (lambda: LightCycle(-1.0, 0.0, 1.0), "visible"),
    (lambda: LightCycle([1.0, 2.0], 0.0, [1.0, 1.0, 1.0]), "sources, intervals"),
    (lambda: advance(resins(), STARTS, LightCycle(np.ones((2, 1)), 0, 1), device="numpy"), "2 sources of light for 3"),
    (lambda: advance([], STARTS, STEADY, device="numpy"), "expected Rates"),
    (lambda: advance(None, STARTS, STEADY, device="numpy"), "expected Rates"),  # type: ignore[arg-type]
    (lambda: advance(resins(), (1, 0, 5), STEADY, device="numpy"), "expected a SpeciesState"),  # type: ignore[arg-type]
    (lambda: advance(resins(), STARTS, 1.0, device="numpy"), "and a LightCycle"),  # type: ignore[arg-type]
    (lambda: advance(resins(), STARTS, STEADY, first=0.5, device="numpy"), "first is 0.5"),  # type: ignore[arg-type]
])  # fmt: skip
def test_bad_input_is_named(make: object, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        make()  # type: ignore[operator]
