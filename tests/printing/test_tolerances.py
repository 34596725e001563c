"""The tolerance table against doses exposed by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import distance_transform_cdt

from vamgpu import Beam, Grid, Projection, Travel, Turntable, Vat, Vial
from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.methods import optimize
from vamgpu.metrics import score
from vamgpu.operators.projection import prepared
from vamgpu.optics.beams import Misaligned
from vamgpu.printing import summary
from vamgpu.printing.judgement import judged
from vamgpu.printing.scenarios import SCENARIOS, Scenario, clouded_and_displaced
from vamgpu.printing.simulate import simulate
from vamgpu.printing.tolerances import ToleranceRow, ToleranceTable, _closed_in, tolerance_table

GRID = Grid((28, 28, 4), 0.2)
BEAM = Beam((32, 4), 0.2)
VIAL = Vial(radius=4.0, wall=0.2, resin_index=1.45, wall_index=1.47, bath_index=1.45, absorption=0.2)
AXIS, DOSE = SCENARIOS[1], SCENARIOS[3]


def bar() -> np.ndarray:
    fraction = np.zeros(GRID.shape)
    fraction[9:20, 11:17] = 1.0
    return fraction


class Print:
    """A bar, its light, and the dose of any operator."""

    def __init__(self, vessel: Vial | Vat | None) -> None:
        self.A = Projection(GRID, BEAM, Turntable(36), vessel, "numpy")
        self.light = optimize(self.A, bar(), iterations=20).sinogram
        self.fraction = self.A.device.upload(bar())
        self.table = tolerance_table(self.A, self.light, self.fraction)

    def dose(self, operator: Projection | None = None) -> DeviceArray:
        return (operator or self.A).T(self.light)


@pytest.fixture(scope="module")
def printed() -> Print:
    return Print(VIAL)


def only(table: ToleranceTable, name: str, change: str) -> ToleranceRow:
    (row,) = [row for row in table.rows if (row.name, row.change) == (name, change)]
    return row


def test_the_nominal_row_is_the_print_itself(printed: Print) -> None:
    scores = score(printed.dose(), printed.fraction)
    nominal = printed.table.nominal
    assert scores.window > 0.02 and nominal.window == pytest.approx(scores.window, abs=1e-6)
    assert nominal.wrong == 0


@pytest.mark.parametrize(
    ("name", "change", "vessel"),
    [
        ("absorption", "−10 %", replace(VIAL, absorption=0.18)),
        ("absorption", "+10 %", replace(VIAL, absorption=0.22)),
        ("axis of rotation", "+0.5 pixel", Misaligned(VIAL, 0.1)),
        ("axis of rotation", "−0.25 pixel", Misaligned(VIAL, -0.05)),
    ],
)
def test_a_row_is_the_same_light_through_what_it_names(printed: Print, name: str, change: str, vessel: object) -> None:
    scores = score(printed.dose(), printed.fraction)
    other = Projection(GRID, BEAM, Turntable(36), vessel, "numpy")  # type: ignore[arg-type]
    wanted = score(printed.dose(other), printed.fraction, threshold=scores.threshold)
    row = only(printed.table, name, change)
    assert row.window == pytest.approx(wanted.window, abs=1e-6)
    assert (row.missing, row.excess) == (wanted.missing, wanted.excess)
    assert abs(row.window - scores.window) > 1e-5


@pytest.mark.parametrize(("change", "times"), [("−30 %", 0.7), ("−5 %", 0.95), ("+5 %", 1.05), ("+40 %", 1.4)])
def test_more_and_less_dose_keep_the_window_and_cost_voxels(printed: Print, change: str, times: float) -> None:
    doses = (replace(DOSE, amounts=(-0.3, -0.05, 0.05, 0.4)),)
    table = tolerance_table(printed.A, printed.light, printed.fraction, scenarios=doses)
    scores, row = score(printed.dose(), printed.fraction), only(table, "dose", change)
    wanted = score(printed.dose(), printed.fraction, threshold=scores.threshold / times)
    assert row.window == pytest.approx(scores.window, abs=1e-6)
    assert (row.missing, row.excess) == (wanted.missing, wanted.excess)
    assert row.wrong or abs(times - 1) < 0.1


def test_the_first_wrong_voxel_is_where_the_print_changes(printed: Print) -> None:
    """Just before every limit no voxel is wrong, just beyond it one is."""
    threshold = score(printed.dose(), printed.fraction).threshold
    seen = 0
    for scenario in SCENARIOS[1:3]:
        for first in printed.table.limits(scenario.name):
            assert first.text and scenario.off is not None
            if np.isnan(first.amount):
                operator = prepared(printed.A, *scenario.off(printed.A, first.farthest))()
                assert score(printed.dose(operator), printed.fraction, threshold=threshold).iou == 1
                continue
            changed = (prepared(printed.A, *scenario.off(printed.A, k * first.amount))() for k in (0.93, 1.07))
            before, beyond = (score(printed.dose(A), printed.fraction, threshold=threshold) for A in changed)
            assert before.missing + before.excess == 0 < beyond.missing + beyond.excess
            seen += 1
    assert seen >= 2
    for first in printed.table.limits("dose"):
        before, beyond = (
            score(printed.dose(), printed.fraction, threshold=threshold / (1 + k * first.amount)) for k in (0.99, 1.01)
        )
        assert before.missing + before.excess == 0 < beyond.missing + beyond.excess


@pytest.mark.slow
def test_a_voxel_that_prints_outside_is_found_as_well(printed: Print) -> None:
    """With a threshold just above what lies outside, excess comes first."""
    own = score(printed.dose(), printed.fraction)
    at = own.greatest_out + 0.05 * own.window * own.peak
    table = tolerance_table(printed.A, printed.light, printed.fraction, threshold=at, scenarios=(AXIS,))
    for first in table.limits(AXIS.name):
        before, beyond = (
            score(printed.dose(clouded_and_displaced(printed.A, 0.0, k * first.amount)), printed.fraction, threshold=at)
            for k in (0.85, 1.15)
        )
        assert before.excess == 0 < beyond.excess and before.missing == 0


def test_exposures_are_counted_and_bounded(printed: Print) -> None:
    rows = sum(len(scenario.amounts) for scenario in SCENARIOS if scenario.off)
    assert 1 + rows <= printed.table.exposures <= 1 + rows + 3 * 5


def curved(root: float, farthest: float) -> tuple[tuple[float, float], list[float]]:
    """The search in a print whose margin falls along a parabola to 0 at ``root``, and the amounts that it asked for."""
    seen: Any = lambda amount: SimpleNamespace(margin=0.1 * (1.0 - (amount / root) ** 2))  # noqa: E731
    known = {amount: seen(amount) for amount in AXIS.amounts}
    search = _closed_in(SimpleNamespace(nominal=seen(0.0)), farthest, known)  # type: ignore[arg-type]
    asked = [next(search)]
    while True:
        try:
            asked.append(search.send(seen(asked[-1])))
        except StopIteration as end:
            return end.value, asked


@pytest.mark.parametrize("root", [0.8, 1.5, -1.1, 0.6])
def test_a_curved_margin_takes_one_more_exposure(root: float) -> None:
    """Three known margins of a parabola give its zero: one exposure confirms it, and none is made at the farthest."""
    (amount, farthest), asked = curved(root, np.sign(root) * AXIS.farthest)
    assert amount == pytest.approx(root, rel=1e-6) and abs(farthest) == AXIS.farthest
    assert asked == [pytest.approx(root, rel=1e-6)]


def test_a_margin_that_stays_takes_the_farthest_amount_alone() -> None:
    (amount, farthest), asked = curved(40.0, AXIS.farthest)
    assert np.isnan(amount) and farthest == AXIS.farthest and asked == [AXIS.farthest]


@pytest.mark.slow
def test_changes_are_added_to_what_was_proved(printed: Print) -> None:
    rng, own = np.random.default_rng(0), printed.dose().numpy()
    dose = own * (1 + 0.02 * rng.random(GRID.shape))
    proved = printed.A.device.upload(dose)
    at = 1.02 * score(proved, printed.fraction).threshold
    table = tolerance_table(printed.A, printed.light, printed.fraction, proved=proved, threshold=at)
    as_proved = score(proved, printed.fraction, threshold=at)
    assert table.nominal.window == pytest.approx(as_proved.window, abs=1e-6)
    for change, vessel in (("+0.5 pixel", Misaligned(VIAL, 0.1)), ("−0.5 pixel", Misaligned(VIAL, -0.1))):
        other = Projection(GRID, BEAM, Turntable(36), vessel, "numpy")
        changed = printed.A.device.upload(dose + printed.dose(other).numpy() - own)
        wanted = score(changed, printed.fraction, threshold=at)
        row = only(table, "axis of rotation", change)
        assert row.window == pytest.approx(wanted.window, abs=1e-6)
        assert (row.missing, row.excess) == (wanted.missing, wanted.excess)
    below, above = table.limits("dose")
    assert below.amount == pytest.approx(at / as_proved.least_in - 1, rel=1e-5)
    assert above.amount == pytest.approx(at / as_proved.greatest_out - 1, rel=1e-5)


@pytest.mark.slow
def test_what_does_not_apply_says_why() -> None:
    straight = Print(None).table
    assert {row.note for row in straight.rows if row.name == "absorption"} == {"the light passes without absorption"}
    assert not straight.limits("absorption") and straight.limits("axis of rotation")
    square = Print(Vat(width=8.0, absorption=0.05))
    notes = {row.note for row in square.table.rows if row.name == "axis of rotation"}
    assert notes == {"a Vat that is not centered on the axis differs at every angle"}


def off_by(limit: float) -> Scenario:
    """The axis of rotation, of which no more than a limit, and nothing below 0, means anything."""

    def off(A: Projection, amount: float) -> tuple[Beam, Any]:
        if not 0 <= amount <= limit:
            raise BadInput(f"{amount:g} is too far")
        return A.beam, clouded_and_displaced(A, 0.0, amount).vessel

    return Scenario("axis", "pixel", (-0.1, 0.01, 0.02, 0.5), 2.0, off)


def test_an_amount_that_means_nothing_leaves_the_others_their_numbers(printed: Print) -> None:
    table = tolerance_table(printed.A, printed.light, printed.fraction, scenarios=(off_by(0.1),))
    below, near, next_, far = table.rows
    assert [row.note for row in table.rows] == ["-0.1 is too far", "", "", "0.5 is too far"]
    assert (near.wrong, next_.wrong) == (0, 0) and np.isfinite([near.window, next_.window]).all()
    assert (below.missing, below.excess, below.wrong, far.wrong) == (None, None, None, None)
    under, over = table.limits("axis")
    assert (under.farthest, under.text) == (0.0, "not exposed") and np.isnan([under.amount, over.amount]).all()
    assert (over.farthest, over.text) == (0.02, "none up to +0.02 pixel")
    groups = summary.table(table)
    assert [row["wrong"] for row in groups[1]["rows"]] == ["–", "0", "0", "–"]
    assert groups[1]["note"] == "not exposed: -0.1 is too far; 0.5 is too far"


def test_a_part_that_moves_sideways_says_why_its_axis_is_not_moved() -> None:
    motion = Turntable(12, lit_share=0.0, travel=Travel([[0.0], [0.02]], x=[[0.03], [-0.05]]))
    A = Projection(GRID, BEAM, motion, None, "numpy")
    light = A.device.upload(np.ones(A.range.shape, np.float32))
    table = tolerance_table(A, light, A.device.upload(bar()))
    notes = {row.name: row.note for row in table.rows}
    assert "moves sideways in Misaligned" in notes["axis of rotation"] and notes["point spread"] == notes["dose"] == ""
    assert table.limits("point spread") and not table.limits("axis of rotation")


def test_voxels_near_the_surface_count_only_where_they_are_asked_for(printed: Print) -> None:
    """Two voxels deep, the least dose of a bar is that of its inner voxels, however the others print."""
    own = printed.dose().numpy()
    inside = bar() > 0
    depth = np.asarray(distance_transform_cdt(np.pad(inside, 3), "chessboard"))[3:-3, 3:-3, 3:-3]
    deep = 1.4 * GRID.pitch
    dose = np.where(inside & (depth == 1), 0.0, own)
    at = score(printed.dose(), printed.fraction).threshold
    proved = printed.A.device.upload(dose)
    near, far, thin = (
        tolerance_table(printed.A, printed.light, printed.fraction, proved=proved, threshold=at, scenarios=(), deep=d)
        for d in (0.0, deep, 9.0)
    )
    assert near.nominal.missing == (inside & (depth == 1) & GRID.cylinder()[..., None]).sum() > 0
    assert far.nominal.wrong == 0 and far.nominal.window > near.nominal.window
    assert thin.nominal == near.nominal, "where nothing lies so deep, all counts"
    (low, high) = tolerance_table(
        printed.A, printed.light, printed.fraction, proved=proved, threshold=at, scenarios=(DOSE,), deep=deep
    ).first_wrong
    around = np.asarray(distance_transform_cdt(np.pad(~inside, 3, constant_values=True), "chessboard"))[
        3:-3, 3:-3, 3:-3
    ]
    outside = (around >= 2) & GRID.cylinder()[..., None]
    assert low.amount == pytest.approx(at / dose[depth >= 2].min() - 1.0, rel=1e-4), "of the voxels that count"
    assert high.amount == pytest.approx(at / dose[outside].max() - 1.0, rel=1e-4)


@pytest.mark.slow
def test_a_flat_print_is_judged_from_its_sides_alone() -> None:
    A = Projection(Grid((17, 17, 1), 0.2), Beam((24, 1), 0.2), Turntable(24), None, "numpy")
    fraction = np.zeros(A.grid.shape)
    fraction[4:13, 4:13] = 1.0
    light = optimize(A, fraction, iterations=20).sinogram
    nominal = tolerance_table(A, light, A.device.upload(fraction), scenarios=(), deep=0.4).nominal
    assert nominal.wrong == 0 and nominal.window > 0.3
    shown: Any = SimpleNamespace(irradiance=lambda device: light, scale=1.0)
    found = judged(simulate(A, shown, fraction))
    assert found.deep == pytest.approx(0.4) and found.over_tolerance.at(0.4) == pytest.approx(nominal.window, abs=0.1)


def test_an_operator_that_is_no_plain_projection_keeps_the_rows_of_the_dose(printed: Print) -> None:
    class Other:
        T = printed.A.T

    table = tolerance_table(Other(), printed.light, printed.fraction)  # type: ignore[arg-type]
    notes = {row.name: row.note for row in table.rows}
    assert notes.pop("dose") == "" and table.exposures == 1 and len(table.first_wrong) == 2
    assert set(notes.values()) == {"got Other; expected a Projection, whose light no insert or medium bends"}


def test_a_print_that_is_wrong_already_says_so(printed: Print) -> None:
    high = 0.99 * score(printed.dose(), printed.fraction).peak
    table = tolerance_table(printed.A, printed.light, printed.fraction, threshold=high, scenarios=(DOSE,))
    assert table.nominal.missing and {first.text for first in table.first_wrong} == {"wrong without an error"}
    assert table.exposures == 1


def test_scenarios_change_one_thing() -> None:
    A = Projection(GRID, BEAM, Turntable(4), VIAL, "numpy")
    softer, off_axis, denser = (scenario.off for scenario in SCENARIOS[:3])
    assert softer is not None and off_axis is not None and denser is not None
    soft, vessel = softer(A, 0.25)
    assert vessel == VIAL
    assert soft.sigma == pytest.approx(0.75) and soft.pixels == BEAM.pixels
    assert softer(Projection(GRID, soft, Turntable(4), VIAL, "numpy"), 0.5)[0].sigma == pytest.approx(1.25)
    aside = clouded_and_displaced(A, 0.0, 0.5)
    assert off_axis(A, 0.5) == (BEAM, aside.vessel) and denser(A, 0.1)[1].absorption == pytest.approx(0.22)
    assert replace(BEAM, spread=0.1).sigma == pytest.approx(0.5)
    assert clouded_and_displaced(aside, 0.0, -0.25).vessel == Misaligned(VIAL, 0.05)
    thin = clouded_and_displaced(aside, -0.1, 0.0).vessel
    assert isinstance(thin, Misaligned) and thin.offset == pytest.approx(0.1) and thin.absorption == pytest.approx(0.18)
    with pytest.raises(BadInput, match="without absorption"):
        clouded_and_displaced(Projection(GRID, BEAM, Turntable(4), device="numpy"), 0.1, 0.0)
    assert Scenario("x", "%", (-0.1, 0.1), 0.5, None).written(-0.05) == "−5 %"
