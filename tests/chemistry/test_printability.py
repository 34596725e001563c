"""Conditions of printability against a search by brute force, disturbed light against geometry, plans against sums."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.chemistry.exposure_plan import Disturbance, TurnLight, disturbances, plan_exposure
from vamgpu.chemistry.printability import (
    PowerVerdict,
    Thresholds,
    TurnDoses,
    most_turns,
    power_window,
    static_inhibition,
    static_turns,
)
from vamgpu.errors import BadInput, EmptyMesh, ShapeMismatch
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.operators.projection import Projection
from vamgpu.optics.vat import Vat

RESIN = Thresholds(1.0, 1.3)
CASES = [
    TurnDoses(0.9, 1.0, 0.5),
    TurnDoses(0.8, 1.1, 0.6),
    TurnDoses(0.7, 0.75, -0.2),
    TurnDoses(0.5, 1.0, 0.45),
    TurnDoses(-0.1, 1.0, 0.2),
    TurnDoses(1.0, 1.0, 0.0),
]


def judge(doses: TurnDoses, thresholds: Thresholds, turns: int, power: float) -> PowerVerdict:
    before, after = (
        TurnDoses(n * power * doses.in_least, n * power * doses.in_most, n * power * doses.out_most)
        for n in (turns - 1, turns)
    )
    return PowerVerdict.of(before, after, thresholds)


def by_hand(doses: TurnDoses, turns: int, power: float) -> bool:
    early = (turns - 1) * power * doses.in_most < RESIN.optical
    overcured = turns * power * doses.out_most >= RESIN.optical
    return early and turns * power * doses.in_least > RESIN.mechanical and not overcured


@pytest.mark.parametrize("doses", CASES)
def test_windows_are_what_a_search_finds(doses: TurnDoses) -> None:
    powers = np.geomspace(0.01, 20.0, 4001)
    for turns in (1, 2, 3, 5, 9):
        window = power_window(doses, RESIN, turns)
        legal = [power for power in powers if by_hand(doses, turns, power)]
        assert window.legal == bool(legal) or window.high / window.low < 1.003
        for power in powers[::50]:
            inside = window.low < power < window.high
            assert inside == by_hand(doses, turns, power) == judge(doses, RESIN, turns, power).holds
    found = [n for n in range(1, 200) if power_window(doses, RESIN, n).legal]
    assert most_turns(doses, RESIN) == (max(found, default=0) if len(found) < 199 else inf)


def test_every_failure_has_its_margin() -> None:
    doses = TurnDoses(0.8, 1.0, 0.5)
    for turns, power, failed in ((3, 0.2, "firm"), (1, 3.0, "overcure"), (3, 0.6, "early")):
        found = judge(doses, RESIN, turns, power)
        assert [name for name in ("early", "firm", "overcure") if getattr(found, name) <= 0.0] == [failed]
    after = PowerVerdict.of(TurnDoses(0.5, 0.9, 0.1), TurnDoses(1.35, 1.6, 0.8), RESIN)
    assert after.holds and after.early == pytest.approx(0.1) and after.firm == pytest.approx(0.05)


def test_static_inhibition_needs_turns_that_add_up_to_the_gap() -> None:
    doses = TurnDoses(0.5, 0.5, 0.42)  # no power makes this legal: T_mec / T_opt > D_in / D_out
    assert most_turns(doses, RESIN) == 0
    assert static_turns(doses, RESIN) == 4 and static_turns(TurnDoses(0.4, 0.6, 0.5), RESIN) == inf
    for turns in range(1, 9):
        shift = static_inhibition(doses, RESIN, turns)
        legal = [d for d in np.linspace(-0.99, 4.0, 2000) if judge(doses, RESIN.delayed(d), turns, 1.0).holds]
        assert shift.legal == bool(legal)
        assert shift.legal == (turns * doses.gap > RESIN.gap)
        if legal:
            assert [shift.low, shift.high] == pytest.approx([min(legal), max(legal)], abs=4e-3)


def lit(device: str | Device = "numpy", uv: bool = True) -> tuple[TurnLight, np.ndarray]:
    """A disc of light and a ring of ultraviolet about the axis."""
    n, pitch = 32, 0.2
    grid, beam, motion = Grid((n, n, 8), pitch), Beam((n, 8), pitch), Turntable(24)
    A = Projection(grid, beam, motion, Vat(8.0, radius=3.2, absorption=0.05), device)
    B = Projection(grid, beam, motion, Vat(8.0, radius=3.2, absorption=0.1), A.device)
    r = np.abs(beam.columns())[None, :, None] * np.ones(A.range.shape)
    light, other = A.device.upload(0.2 * (r < 1.5)), A.device.upload(0.1 * (r > 1.5))
    x, y, _ = np.meshgrid(*grid.axes(), indexing="ij")
    turn = TurnLight(A, light, B, other, 2.0) if uv else TurnLight(A, light)
    return turn, (np.hypot(x, y) < 1.3).astype(float)


def test_the_dose_of_a_turn_is_that_of_its_colors(device: Device) -> None:
    turn, target = lit(device)
    assert turn.ultraviolet is not None
    unit = 0.2**2 / 0.2**3
    wanted = unit * (turn.visible.T(turn.light).numpy() - 2.0 * turn.ultraviolet.T(turn.ultraviolet_light).numpy())
    got = turn.dose().numpy()
    assert np.abs(got - wanted).max() <= 1e-5 * np.abs(wanted).max()
    doses = turn.doses(device.upload(target))[0]
    near = np.broadcast_to(turn.visible.grid.cylinder()[..., None], wanted.shape)
    extremes = [wanted[target == 1].min(), wanted[target == 1].max(), wanted[(target == 0) & near].max()]
    assert [doses.in_least, doses.in_most, doses.out_most] == pytest.approx(extremes, rel=1e-5)
    assert TurnDoses.of(wanted, target, 15.5 * (1 + 1e-6)).gap == pytest.approx(doses.gap, rel=1e-5)
    assert wanted.min() < 0


def test_disturbances_do_what_they_say() -> None:
    turn, target = lit()
    still = turn.dose().numpy()
    brighter = turn.dose(Disturbance(visible=1.1, ultraviolet=1.1)).numpy()
    assert np.allclose(brighter, 1.1 * still, rtol=1e-12)
    # an axis one column off turns light on another circle: the disc grows by a column, and stays symmetric
    off = turn.dose(Disturbance(axis=0.2)).numpy()
    assert np.abs(off - still).max() > 0.05 * still.max()
    assert off.sum() == pytest.approx(still.sum(), rel=0.1)
    blurred = turn.dose(Disturbance(blur=0.8)).numpy()
    steepest = [np.abs(np.diff(plane[:, 16, 4])).max() for plane in (still, blurred)]
    assert steepest[1] < 0.8 * steepest[0]
    alone, _ = lit(uv=False)
    assert np.allclose(turn.dose(Disturbance(ultraviolet=0.0)).numpy(), alone.dose().numpy())


@pytest.mark.slow
def test_the_worst_case_narrows_the_window() -> None:
    turn, target = lit()
    resin, device = Thresholds(1.0, 1.01), turn.visible.device
    cases = disturbances(dose=0.1, axis=0.05, blur=0.3)
    assert len(cases) == 2 * 2 * 3 * 2
    every = turn.doses(device.upload(target), cases)
    worst, plain = TurnDoses.worst(*every), turn.doses(device.upload(target))[0]
    for turns in (1, 2, 4):
        robust, single = power_window(worst, resin, turns), power_window(plain, resin, turns)
        windows = [power_window(doses, resin, turns) for doses in every]
        assert robust.low == pytest.approx(max(w.low for w in windows))
        assert robust.high == pytest.approx(min(w.high for w in windows))
        assert robust.low > single.low and robust.high < single.high
    only = turn.doses(device.upload(target), [Disturbance(0.9, 0.9), Disturbance(1.1, 1.1)])
    narrow = power_window(TurnDoses.worst(*only), resin, 1)
    assert narrow.low == pytest.approx(power_window(plain, resin, 1).low / 0.9)
    assert narrow.high == pytest.approx(power_window(plain, resin, 1).high / 1.1)


def test_the_plan_sends_what_the_light_holds() -> None:
    turn, _ = lit()
    plan = plan_exposure(turn, 3, 2.0, period=12.0)
    frame = 12.0 / 24
    assert (plan.seconds, plan.frame) == (36.0, frame)
    assert plan.visible_peak == pytest.approx(2.0 * 0.2 / frame * 100)  # mJ/mm² over seconds, in mW/cm²
    assert plan.ultraviolet_peak == pytest.approx(2.0 * 0.1 / frame * 100)
    sent = 3 * 2.0 * turn.light.numpy().sum() * turn.visible.beam.pixel_area
    assert plan.visible_energy == pytest.approx(sent)
    mean = plan.visible_mean / 100 * 24 * frame * 3 * turn.light.numpy()[0].size * turn.visible.beam.pixel_area
    assert plan.visible_energy == pytest.approx(mean)
    quick = plan_exposure(turn, 3, 2.0, visible_limit=50.0, ultraviolet_limit=10.0)
    assert quick.ultraviolet_peak == pytest.approx(10.0) and quick.visible_peak < 50.0


def test_wrong_input_is_refused() -> None:
    turn, target = lit()
    with pytest.raises(BadInput, match="firm only after"):
        Thresholds(1.0, 0.9)
    with pytest.raises(BadInput, match="in_least"):
        TurnDoses(1.0, 0.5, 0.0)
    with pytest.raises(BadInput, match="no cases"):
        TurnDoses.worst()
    with pytest.raises(EmptyMesh):
        TurnDoses.of(np.ones((4, 4, 4)), np.ones((4, 4, 4)))
    with pytest.raises(ShapeMismatch):
        TurnDoses.of(np.ones((4, 4, 4)), np.ones((4, 4, 5)))
    with pytest.raises(BadInput, match="share below 1"):
        disturbances(dose=1.2)
    with pytest.raises(BadInput, match="axis .mm. is nan; expected a finite"):
        Disturbance(axis=float("nan"))
    with pytest.raises(BadInput, match="at least"):
        plan_exposure(turn, 3, 2.0, period=1.0, visible_limit=5.0)
    with pytest.raises(BadInput, match="no limit for ultraviolet"):
        plan_exposure(turn, 3, 2.0, visible_limit=5.0)
    with pytest.raises(BadInput, match="both or neither"):
        TurnLight(turn.visible, turn.light, turn.visible)
    with pytest.raises(ShapeMismatch):
        TurnLight(turn.visible, turn.visible.device.upload(target))
    with pytest.raises(BadInput, match="turns"):
        power_window(CASES[0], RESIN, 0)
