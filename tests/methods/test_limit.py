"""Light in a limited time, against linear programming and the time that a proof predicts."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import numpy as np
import pytest
from widest import entries_of, widest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OpticsWarning, SamplingWarning
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.methods import Plan, Tolerances, optimize, pareto
from vamgpu.methods.limit import ExposureLimit
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial
from vamgpu.printing.pack import pack
from vamgpu.printing.simulate import simulate
from vamgpu.units import mJ_cm3, mW_cm2, s

SIZE, PITCH = 16, 0.2
GIVEN: dict[str, Any] = {"irradiance": 40 * mW_cm2, "critical_dose": 50 * mJ_cm3}


def operator(device: Device | str | None) -> Projection:
    vial = Vial(radius=3.0, wall=0.3, resin_index=1.5, wall_index=1.5, bath_index=1.5, absorption=0.1)
    return Projection(Grid((SIZE, SIZE, 1), PITCH), Beam((24, 1), PITCH), Turntable(24), vial, device)


def cross() -> np.ndarray:
    x, y = np.meshgrid(*2 * [np.arange(SIZE) - 0.5 * (SIZE - 1)], indexing="ij")
    return (((abs(x) < 2) | (abs(y) < 2)) & (np.hypot(x, y) < 6.5))[:, :, None].astype(np.float32)


@cache
def optimum(brightness: float) -> float:
    exact = operator("numpy")
    inside, near = cross().ravel() > 0.5, exact.grid.cylinder().ravel()
    entries = entries_of(exact)
    return widest(entries[inside & near], entries[~inside & near], brightness)


def seconds_of(plan: Any) -> float:
    """By the proof of its frames."""
    proof = simulate(plan.operator, pack(plan, quantile=1.0), cross(), **GIVEN)
    assert proof.seconds is not None
    return proof.seconds


def quietly(*given: Any, **more: Any) -> Plan:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OpticsWarning)  # of a window that is gone
        warnings.simplefilter("ignore", SamplingWarning)
        return optimize(*given, **more)


def test_windows_in_a_time_are_near_the_optimum_and_never_beyond(fast_device: Device) -> None:
    A = operator(fast_device)
    free = quietly(A, cross(), iterations=120)
    last, windows = seconds_of(free), [free.window]
    for share in (0.8, 0.6):
        limit = ExposureLimit(share * last, **GIVEN)
        plan = quietly(A, cross(), iterations=120, exposure_limit=share * last * s, **GIVEN)
        top = optimum(limit.brightness(A))
        assert 0.4 * top < plan.window <= top + 1e-4, (share, plan.window, top)
        assert 0.5 * share * last < seconds_of(plan) <= 1.02 * share * last  # frames of 8 bits round
        windows.append(plan.window)
    assert windows[-1] < windows[0]


def test_a_limit_beyond_what_light_takes_changes_nothing() -> None:
    A = operator("numpy")
    longest, long = (quietly(A, cross(), iterations=12, exposure_limit=limit, **GIVEN) for limit in ("2 h", "1 h"))
    assert np.array_equal(longest.sinogram.numpy(), long.sinogram.numpy())


def test_the_default_keeps_to_a_limit() -> None:
    plan = quietly(operator("numpy"), cross(), iterations=10, exposure_limit="3 s", **GIVEN)
    assert 0.9 * 3 <= seconds_of(plan) <= 1.02 * 3


def test_limits_that_cannot_be_kept_say_what_binds() -> None:
    A = operator("numpy")
    said = (
        r"limit of 0.5 s is too short: with all pixels full-on at 0.4 mW/mm² the darkest voxel of the part takes \d.* s"
    )
    with pytest.raises(BadInput, match=said):
        optimize(A, cross(), iterations=5, exposure_limit=0.5, **GIVEN)
    ring = cross() * 0.0
    ring[3:13, 3:13], ring[6:10, 6:10] = 1.0, 0.0
    even = float(np.asarray(A.T(np.ones(A.range.shape, np.float32)))[ring > 0.5].min())
    least = 1.0 / (ExposureLimit(1.0, **GIVEN).brightness(A) * even)
    with pytest.warns(OpticsWarning, match="no patterns with a strict window were found within the exposure limit"):
        optimize(A, ring, iterations=20, exposure_limit=1.01 * least, **GIVEN)


def test_bad_limits_say_what_was_expected() -> None:
    A = operator("numpy")
    open_air = Projection(Grid((SIZE, SIZE, 1), PITCH), Beam((24, 1), PITCH), Turntable(24), device="numpy")
    plan = optimize(A, cross(), iterations=3, exposure_limit=60 * s, **GIVEN)
    for where, options, said in (
        (A, {"method": "lbfgs", "exposure_limit": 60 * s, **GIVEN}, 'expected "default"'),
        (A, {"exposure_limit": 60 * s}, "exposure_limit without irradiance"),
        (A, GIVEN, "without exposure_limit"),
        (A, {"exposure_limit": "60 mm", **GIVEN}, "exposure_limit: got '60 mm'"),
        (A, {"exposure_limit": -1.0, **GIVEN}, "exposure_limit"),
        (open_air, {"exposure_limit": 60 * s, **GIVEN}, "absorbs no light"),
        (A, {"exposure_limit": 50 * s, "resume": plan, **GIVEN}, "another exposure limit"),
        (A, {"resume": plan}, "has an exposure limit"),
    ):
        given: dict[str, Any] = {"iterations": 5, **options}
        with pytest.raises(BadInput, match=said):
            optimize(where, cross(), **given)


def test_shorter_exposures_cost_window_and_are_told_by_their_times() -> None:
    plan = quietly(operator(None), cross(), iterations=60)
    points = pareto(plan, **GIVEN, evaluations=60)
    times, windows = ([getattr(point, name) for point in points] for name in ("seconds", "window"))
    assert len(points) >= 3 and points[0].window > plan.window  # a pixel from the surface, not at it
    assert times == sorted(times, reverse=True) and windows[-1] < 0.9 * windows[0] and min(windows) > 0.0
    assert times[0] == pytest.approx(seconds_of(plan), rel=0.02)
    dose, near = np.asarray(plan.operator.T(plan.sinogram.numpy())), operator("numpy").grid.cylinder()[:, :, None]  # type: ignore[attr-defined]
    part = cross() > 0.5
    assert points[0].outside == pytest.approx(dose[~part & near].mean() / dose[part & near].mean(), rel=1e-6)
    off = optimize(operator("numpy"), cross(), "lbfgs", 5, tolerances=Tolerances(dose=0.01))
    with pytest.raises(BadInput, match="a plan with tolerances"):
        pareto(off, **GIVEN)
