"""Light for all corners of tolerances: its operators, its window, its bound, what contradicts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ToleranceError, ToleranceWarning
from vamgpu.methods.tolerances import Corner, Tolerances, at
from vamgpu.operators.scenarios import Scenarios
from vamgpu.optics.beams import Misaligned

N, PITCH = 20, 0.1
GRID, TURN = vam.Grid((N, N, 3), PITCH), vam.Turntable(24)
BEAM = vam.Beam((30, 3), PITCH, spread=0.05)
VIAL = vam.Vial(4.0, 0.5, 1.48, 1.47, 1.4, absorption=0.2)
BOTH = Tolerances(axis=0.015, spread=(0.05, 0.07))


@cache
def ring() -> np.ndarray:
    x, y = np.meshgrid(*2 * [np.arange(N) - (N - 1) / 2], indexing="ij")
    r = np.hypot(x, y)
    return np.repeat(((r < 7.5) & (r > 3.0))[:, :, None], 3, axis=2).astype(np.float32)


def projection(device: Device | str = "numpy", vessel: vam.Vial | None = None) -> vam.Projection:
    return vam.Projection(GRID, BEAM, TURN, vessel, device=device)


def light(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((24, 30, 3)).astype(np.float32)


# ---- scenarios -------------------------------------------------------------------------------------------------------
def test_scenarios_are_the_operators_side_by_side_and_their_transpose(device: Device) -> None:
    operators = [at(projection(device), corner) for corner in BOTH.corners()]
    mix = np.eye(9)
    mix[1, 0], mix[4, 4] = 0.5, 1.1
    stack = Scenarios(operators, mix)
    assert stack.dot_test() < 1e-7
    dose, every = stack.T(light()), [each.T(light()) for each in operators]
    for s in range(9):
        expected = sum(share * one for share, one in zip(mix[s], every, strict=True))
        assert np.allclose(dose[:, :, 3 * s : 3 * s + 3], expected, rtol=1e-5, atol=1e-7)


def test_a_volume_that_is_zero_is_not_projected(device: Device) -> None:
    A = projection(device)
    stack = Scenarios([A, at(A, Corner(axis=0.02)), at(A, Corner(axis=-0.02))])
    volume = np.zeros(stack.domain.shape, np.float32)
    volume[:, :, 6:] = ring()
    image = stack(volume)
    assert stack.cost == 3.0 and stack.projections == 0.5
    assert np.allclose(image, at(A, Corner(axis=-0.02))(ring()), rtol=1e-5, atol=1e-6)


# ---- corners ---------------------------------------------------------------------------------------------------------
def test_corners_are_every_combination_of_ends_the_nominal_print_and_the_middles_of_faces() -> None:
    every = Tolerances(axis=0.02, spread=(0.04, 0.08), absorption=0.1, index=0.01, wobble=0.03, dose=0.02).corners()
    assert every[0] == Corner() and len(every) == 1 + 2**5 * 4 + 2 * (4 * 2 + 4)
    ends = {(a, s) for a in (-0.015, 0.015) for s in (0.05, 0.07)}
    faces = {(-0.015, 0.06), (0.015, 0.06), (0.0, 0.05), (0.0, 0.07)}
    found = [(c.axis, c.spread and round(c.spread, 9)) for c in BOTH.corners()[1:]]
    assert set(found) == ends | faces and len(found) == 8
    assert len(Tolerances(axis=0.02, dose=0.02).corners()) == 5  # the nominal print stands for the middle


def test_every_corner_has_the_operator_that_it_says() -> None:
    A, light_ = projection(vessel=VIAL), light()
    for corner, other in (
        (Corner(spread=0.08), replace_beam(A, 0.08)),
        (Corner(absorption=0.1), projection(vessel=replace(VIAL, absorption=0.22))),
        (Corner(index=-0.01), projection(vessel=replace(VIAL, resin_index=1.47))),
        (Corner(axis=0.02), vam.Projection(GRID, BEAM, TURN, Misaligned(VIAL, offset=0.02), device="numpy")),
    ):
        assert np.allclose(at(A, corner).T(light_), other.T(light_), rtol=1e-6), str(corner)
        assert not np.allclose(A.T(light_), other.T(light_), rtol=1e-4), "which is another one"


def replace_beam(A: vam.Projection, spread: float) -> vam.Projection:
    return vam.Projection(A.grid, replace(A.beam, spread=spread), A.motion, A.vessel, "numpy")


def test_a_whole_column_off_is_light_moved_by_a_column() -> None:
    """In air, and by a vial off its axis too: its place turns with it."""
    A, one = projection(), light()
    one[:, :3] = one[:, -3:] = 0.0
    moved = at(A, Corner(axis=PITCH)).T(np.roll(one, 1, axis=1))
    assert np.allclose(moved, A.T(one), rtol=2e-3, atol=2e-3 * A.T(one).max())
    shifted = at(A, Corner(wobble=(PITCH, 0.0))).T(one)
    inner = slice(5, -5)
    assert np.allclose(shifted[4:-6, inner], A.T(one)[inner, inner], rtol=0.2, atol=0.1 * A.T(one).max())


def test_mean_and_spread_brings_corners_nearer_to_their_mean() -> None:
    worst, milder = (replace(BOTH, judged=j).scenarios(projection()).mix for j in ("worst", "mean + spread"))
    mean = worst[1:].mean(axis=0)
    assert np.allclose(milder - mean, (worst - mean) / np.sqrt(2.0))


# ---- light -----------------------------------------------------------------------------------------------------------
def test_one_light_prints_at_all_corners_with_one_threshold(device: Device) -> None:
    A = projection(device)
    few: dict[str, Any] = {"iterations": 24}
    plan = vam.optimize(A, ring(), **few, tolerances=BOTH)
    plain = vam.optimize(A, ring(), **few)
    told = BOTH.doses(A, plan, ring())
    assert plan.corners is not None and plan.window == pytest.approx(told.window, abs=1e-5)
    far = Tolerances(axis=0.08)  # more than what the default bears by itself
    assert vam.optimize(A, ring(), **few, tolerances=far).window > far.doses(A, plain, ring()).window + 0.003
    least = min(float(d[ring() > 0.5].min()) for d in doses(A, plan))
    leak = max(float(d[near() & (ring() < 0.5)].max()) for d in doses(A, plan))
    top = max(float(d[near()].max()) for d in doses(A, plan))
    assert plan.window == pytest.approx((least - leak) / top, abs=1e-5)


def doses(A: vam.Projection, plan: vam.Plan) -> list[np.ndarray]:
    return [np.asarray(at(A, corner).T(plan.sinogram.numpy())) for corner in BOTH.corners()]


def near() -> np.ndarray:
    return np.repeat(GRID.cylinder()[:, :, None], 3, axis=2)


def test_every_method_takes_tolerances() -> None:
    A = projection(vam.open_device(None))
    for method in ("osmo", "recipe", "lbfgs"):
        with pytest.warns(ToleranceWarning) if method == "recipe" else no_warning():
            plan = vam.optimize(A, ring(), method, iterations=6, tolerances=BOTH)
        assert plan.corners is not None and len(plan.corners.corners) == 9


class no_warning:  # noqa: N801 - stands for a context manager
    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


def test_a_resumed_run_is_the_whole_run_and_takes_the_same_tolerances() -> None:
    A = projection(vam.open_device(None))
    whole = vam.optimize(A, ring(), iterations=6, tolerances=BOTH)
    half = vam.optimize(A, ring(), iterations=4, tolerances=BOTH)
    rest = vam.optimize(A, ring(), iterations=6, tolerances=BOTH, resume=half)
    assert np.array_equal(whole.sinogram.numpy(), rest.sinogram.numpy())
    with pytest.raises(BadInput, match="tolerances|Tolerances"):
        vam.optimize(A, ring(), iterations=7, resume=half)


# ---- what contradicts ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("given", "binds"),
    [
        ({"absorption": 0.1}, "absorption"),
        ({"index": 0.01}, "index"),
        ({"axis": 3.0}, "axis"),
        ({"wobble": 3.0}, "wobble"),
    ],
)
def test_a_tolerance_that_contradicts_the_print_says_so(given: dict[str, float], binds: str) -> None:
    with pytest.raises(ToleranceError, match=binds) as caught:
        vam.optimize(projection(), ring(), iterations=2, tolerances=Tolerances(**given))  # type: ignore[arg-type]
    assert caught.value.binds == binds


def test_bad_tolerances_are_refused() -> None:
    with pytest.raises(ToleranceError, match="least one first"):
        Tolerances(spread=(0.2, 0.1))
    wrong: list[dict[str, Any]] = [{"absorption": 1.5}, {"axis": -0.1}, {"judged": "best"}, {"spread": 0.1}]
    for given in wrong:
        with pytest.raises(BadInput):
            Tolerances(**given)


def test_light_that_does_not_print_at_every_corner_says_which_hold_it() -> None:
    with pytest.warns(ToleranceWarning, match="least dose in the part at .* most outside at"):
        vam.optimize(projection(), ring(), iterations=4, tolerances=Tolerances(axis=0.2, dose=0.2))
