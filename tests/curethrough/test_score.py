"""Heights of single features against those of whole pixels, and what a table of features says."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.curethrough.correction import Correction
from vamgpu.curethrough.dose import column_dose
from vamgpu.curethrough.job import correct_stack, model
from vamgpu.curethrough.layers import LayerPrinter
from vamgpu.curethrough.printer import Printer, levels_of
from vamgpu.curethrough.report import lines, page_of
from vamgpu.curethrough.score import cured, features, grouped, ratio, sample
from vamgpu.errors import SliceWarning

LIGHT = levels_of(1.0, 0.01)
PRINTER = Printer(2.0, 0.576, 0.05, 1000 / 3600, LIGHT)
LAYERS = LayerPrinter(0.11, 0.2, 0.05, 1.0, levels_of(0.03, 0.0002))


def columns(slices: int = 90, count: int = 40) -> np.ndarray:
    """Random runs of solid slices at random gray, [slice, column]."""
    rng = np.random.default_rng(11)
    edges = rng.random((slices, count)) < 0.08
    solid = (np.cumsum(edges, axis=0) + rng.integers(0, 2, count)) % 2 == 1
    return np.where(solid, rng.integers(128, 256, (slices, count)), 0).astype(np.uint8)


@pytest.mark.parametrize("machine", [PRINTER, LAYERS], ids=["continuous", "layers"])
def test_cured_shares_are_those_of_the_dose_between_the_borders(machine: Printer | LayerPrinter) -> None:
    shown = columns(60, 5)
    steps = 400
    places = (np.arange(60 * steps) + 0.5) / steps
    for k in range(shown.shape[1]):
        dense = (column_dose(machine, shown[:, k], places) >= 1.0).reshape(60, steps).mean(axis=1)
        share = cured(machine, shown[:, k : k + 1])[:, 0]
        if machine.layered:  # slice n cures from ζ = n − 1 to n
            dense, share = dense[:-1], share[1:]
        assert np.abs(dense - share).max() <= 1.5 / steps


def test_features_add_up_to_what_their_pixels_have() -> None:
    shown = columns()
    stack = shown[:, None, :]
    found = model(PRINTER, stack, device="numpy")
    part = features(PRINTER, shown, shown >= 128)
    over = np.bincount(part.column, part.over, minlength=40)
    under = np.bincount(part.column, part.under, minlength=40)
    solid = shown >= 128
    last = np.where(solid.any(axis=0), len(solid) - np.argmax(solid[::-1], axis=0), 0)
    share = cured(PRINTER, shown)
    beyond = np.array([share[last[k] :, k].sum() * 0.05 for k in range(40)])
    np.testing.assert_allclose(over + beyond, found.before.heights.over[0], atol=2e-5)
    np.testing.assert_allclose(under, found.before.heights.under[0], atol=2e-5)
    assert len(part) == (np.diff(solid.astype(int), axis=0, prepend=0) == 1).sum()


def test_places_of_features_and_the_void_behind_them() -> None:
    shown = np.zeros((30, 2), np.uint8)
    shown[3:8, 0] = shown[12:20, 0] = shown[:5, 1] = 255
    part = features(PRINTER, shown, shown >= 128)
    np.testing.assert_array_equal([part.column, part.front, part.back, part.behind],
                                  [[0, 0, 1], [3, 12, 0], [8, 20, 5], [4, 10, 25]])  # fmt: skip
    assert part.over[2] == 0, "nothing lies before what begins at the platform"
    groups = grouped(part)
    assert {(g.front, g.back, g.columns) for g in groups} == {(3, 8, 1), (12, 20, 1), (0, 5, 1)}
    assert all(g.ratio is None for g in groups)


def test_a_correction_lowers_what_is_scored() -> None:
    stack = np.zeros((120, 6, 8), np.uint8)
    stack[:10, 1:5, 1:7] = stack[40:60, 1:5, 1:7] = stack[90:112, 2:4, 1:4] = 255
    found = correct_stack(Correction(PRINTER), stack, device="numpy")
    assert found.after is not None and found.ratio is not None and found.ratio < 0.01
    together, middle = ratio(found.before.features, found.after.features)
    assert together < 0.01 and middle < 0.01
    assert found.after.levels.shape[0] == 120 + PRINTER.tail
    names = [name for name, _, _ in lines(found)]
    assert "error ratio" in names and "features out of reach" in names
    page = page_of(found, "<part>").html()
    assert "&lt;part&gt;" in page and page.count("<tr>") > 5


def test_features_out_of_reach_are_counted_and_told() -> None:
    stack = np.zeros((60, 2, 3), np.uint8)
    stack[5:20] = stack[21:40] = 255  # one slice of void is too short for full light
    found = correct_stack(Correction(PRINTER), stack, device="numpy")
    assert found.closed is not None and int(found.closed.sum()) == 6
    assert "6 voids are too short" in page_of(found, "x").html()
    bare = correct_stack(Correction(PRINTER, tail=0), stack[:40], device="numpy")
    assert bare.missed is not None and int(bare.missed.sum()) == 6
    assert "6 features have too little space behind" in page_of(bare, "x").html()


def test_whole_columns_are_weighed_only_where_something_is_out_of_reach(device: Device) -> None:
    stack = np.zeros((70, 3, 20), np.uint8)
    stack[5:20] = stack[40:60] = 255
    stack[21:40, 1, 4:9] = 255  # one slice of void
    plain = correct_stack(Correction(PRINTER), stack, device=device)
    whole = correct_stack(Correction(PRINTER), stack, device=device, whole_columns=True)
    assert plain.after is not None and whole.after is not None and plain.closed is not None
    bad = np.zeros((3, 20), bool)
    bad[1, 4:9] = True
    np.testing.assert_array_equal(plain.closed > 0, bad)
    errors = [one.heights.over + one.heights.under for one in (plain.after, whole.after)]
    np.testing.assert_array_equal(errors[0][~bad], errors[1][~bad])
    assert (errors[1][bad] < 0.8 * errors[0][bad]).all()
    rows = bad[whole.sample.rows, whole.sample.columns]
    np.testing.assert_array_equal(plain.after.levels[:, ~rows], whole.after.levels[:, ~rows])


def test_a_correction_that_harms_is_told_with_the_heights() -> None:
    """Full slices print without it; with it each of the columns lacks what a float64 model of the dose says."""
    machine, stack = LayerPrinter(0.3, 0.01, 0.05, 2.0, levels_of(0.01, 0.0)), np.full((6, 8, 8), 255, np.uint8)
    found = correct_stack(Correction(machine), stack, device="numpy")
    assert found.after is not None and found.before.heights.error == 0
    places = (np.arange(60_000) + 0.5) / 10_000 - 1  # slice n cures from ζ = n − 1 to n
    dense = column_dose(machine, found.after.levels[:, 0], places)
    lacks = 64 * 0.05 * 6 * (dense < 1.0).mean()
    assert found.after.heights.error == pytest.approx(lacks, abs=64 * 1e-5) and lacks > 0.1
    prints, said = found.verdict
    assert not prints and "raises height errors from 0" in said and said.endswith("print without it.")


def test_a_correction_that_leaves_errors_does_not_print() -> None:
    """Layers of 50 µm, each too dark below: a tenth of the errors is left, a third of a slice in every column."""
    stack = np.zeros((70, 4, 5), np.uint8)
    stack[:8] = stack[40:64] = 255
    found = correct_stack(Correction(LayerPrinter(0.11, 0.576, 0.05, 0.9, LIGHT)), stack, device="numpy")
    assert found.after is not None and found.ratio is not None and found.ratio < 0.5
    prints, said = found.verdict
    assert not prints and "20 columns of pixels print incorrectly, by" in said and "leaves" in said


def test_an_empty_stack_of_darkness_is_scored() -> None:
    found = correct_stack(Correction(PRINTER), np.zeros((40, 3, 4), np.uint8), device="numpy")
    assert repr(found) == "Outcome(40 × 3 × 4 slices, y, x: The slices print correctly without a correction.)"
    assert found.ratio is None and len(found.before.features) == 0
    assert "print correctly without a correction" in page_of(found, "x").html()
    assert sample(np.zeros((4, 3, 5), np.uint8)).width == 5


def test_darkness_that_cures_is_warned_of() -> None:
    bright = Printer(2.0, 0.576, 0.05, 1000 / 3600, levels_of(1.0, 0.2))
    with pytest.warns(SliceWarning, match=r"1.25 critical doses behind.*1.25 times faster"):
        model(bright, columns()[:, None, :], device="numpy")
