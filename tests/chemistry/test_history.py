"""The state of a vial from print to print, its file, and what its model of aging is worth."""

from __future__ import annotations

import json
from dataclasses import replace
from math import exp, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.chemistry.aging import BENCHY_DEVIATIONS, BENCHY_SECONDS, Aging, fit_aging
from vamgpu.chemistry.history import ResinHistory, recovery
from vamgpu.errors import BadInput, StorageError

FRESH = ResinHistory("dudma-pegda", depth=30.0)


def day(vial: ResinHistory) -> ResinHistory:
    """A print, stirring and a night."""
    printed = vial.printed(spent=0.25, lost=0.125, dose=0.02, seconds=50.0, note="boat")
    return printed.stirred(0.1).rested(57600.0, 4e-6)


# ---- recovery ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("number", [5e-4, 9.9e-4, 1.01e-3, 0.05, 0.3, 2.0])
def test_recovery_is_that_of_a_diffusing_layer(number: float) -> None:
    n = 400
    edge = 1.0 / n
    matrix = np.diag(np.full(n, -2.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    matrix[0, 0], matrix[-1, -1] = -3.0, -1.0  # saturated surface half a cell away; closed bottom
    values, vectors = np.linalg.eigh(matrix / edge**2)
    missing = vectors @ (np.exp(number * values) * (vectors.T @ np.ones(n)))
    assert recovery(1.0, number, 1.0) == pytest.approx(1.0 - missing.mean(), rel=2e-3)


def test_recovery_grows_with_time_and_as_the_root_at_first() -> None:
    assert recovery(1e-6, 0.0, 10.0) == 0.0
    assert recovery(1e-6, 400.0, 10.0) == pytest.approx(2.0 * sqrt(4e-6 / pi))
    assert recovery(1e-6, 1e12, 10.0) == pytest.approx(1.0)
    assert recovery(3e-6, 900.0, 5.0) == pytest.approx(recovery(3e-6, 3600.0, 10.0))


def test_a_night_without_stirring_gives_a_deep_vial_little() -> None:
    assert recovery(4e-6, 57600.0, 30.0) < 0.02


# ---- states ------------------------------------------------------------------------------------------------------
def test_a_day_changes_what_it_should() -> None:
    vial = day(FRESH)
    after = 0.75 + 0.1 * 0.25
    assert vial.depth == pytest.approx(30.0 * 0.875)
    assert vial.oxygen == pytest.approx(after + recovery(4e-6, 57600.0, vial.depth) * (1.0 - after))
    assert (vial.prints, vial.dose, [e.kind for e in vial.events]) == (1, 0.02, ["print", "stir", "rest"])
    assert vial.seconds(56.8) == pytest.approx(56.8 * vial.oxygen)
    assert FRESH.oxygen == 1.0 and FRESH.events == ()


def test_less_resin_recovers_faster() -> None:
    half = replace(FRESH, oxygen=0.5)
    shallow = replace(half, depth=10.0)
    assert shallow.rested(1e4, 4e-6).oxygen > half.rested(1e4, 4e-6).oxygen > 0.5


def test_a_state_reads_back_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "vial 3.json"
    vial = day(day(FRESH))
    vial.save(path)
    assert ResinHistory.load(path) == vial
    day(vial).save(path)
    assert ResinHistory.load(path).prints == 3
    assert [entry.name for entry in tmp_path.iterdir()] == ["vial 3.json"]
    assert json.loads(path.read_text())["units"]["depth"] == "mm"


@pytest.mark.parametrize(
    "text", ["", "{}", "[1]", '{"format": "else", "version": 1}', '{"format": "vamgpu resin history", "version": 99}']
)
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "vial.json"
    path.write_text(text)
    with pytest.raises(StorageError, match=r"vial\.json"):
        ResinHistory.load(path)


def test_files_with_impossible_states_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "vial.json"
    FRESH.save(path)
    path.write_text(path.read_text().replace('"oxygen": 1.0', '"oxygen": -1.0'))
    with pytest.raises(StorageError, match="oxygen"):
        ResinHistory.load(path)
    with pytest.raises(StorageError, match="does not exist"):
        ResinHistory.load(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: ResinHistory("", depth=0.0), "depth"),
        (lambda: ResinHistory("", depth=1.0, oxygen=-0.1), "oxygen"),
        (lambda: FRESH.printed(spent=1.5, lost=0.1), "spent"),
        (lambda: FRESH.printed(spent=0.2, lost=1.0), "lost"),
        (lambda: FRESH.printed(spent=0.2, lost=0.1, dose=-1.0), "dose"),
        (lambda: FRESH.printed(spent=0.2, lost=0.1, seconds=float("nan")), "seconds"),
        (lambda: FRESH.stirred(air=2.0), "air"),
        (lambda: FRESH.rested(-1.0, 1e-6), "seconds"),
        (lambda: FRESH.rested(1.0, 0.0), "diffusivity"),
        (lambda: FRESH.seconds(0.0), "fresh"),
        (lambda: Aging(50.0, 1.0, 0.1), "spent"),
        (lambda: fit_aging((50.0, 40.0, 35.0)), "at least 4"),
        (lambda: fit_aging((50.0, 40.0, 35.0, -1.0)), "print time"),
        (lambda: fit_aging(deviations=(1.0, 1.0)), "one each"),
    ],
)
def test_impossible_values_are_refused_by_name(make: Any, complaint: str) -> None:
    with pytest.raises(BadInput, match=complaint):
        make()


# ---- aging -------------------------------------------------------------------------------------------------------
def test_aging_without_recovery_is_a_geometric_series() -> None:
    times = Aging(60.0, 0.2, 0.0).seconds(4)
    assert times == pytest.approx([60.0 * 0.8**k for k in range(4)])


def test_a_fit_finds_the_numbers_it_was_made_from() -> None:
    made = Aging(57.0, 0.25, 0.03)
    found = fit_aging(made.seconds(6))
    assert found.aging.spent == pytest.approx(made.spent, rel=1e-3)
    assert found.aging.refill == pytest.approx(made.refill, rel=1e-2)
    assert found.error < 0.01


def test_five_generations_are_predicted_better_than_by_their_mean_and_worse_than_fitted() -> None:
    found = fit_aging()
    assert found.residual < found.error
    assert found.error == pytest.approx(1.98, abs=0.05)
    assert found.naive_error == pytest.approx(8.58, abs=0.01)
    assert max(abs(gap) for gap in found.left_out) < 3.5
    assert found.left_out[4] < -2.0  # the last point, longer than the one before, is not foreseen


@pytest.mark.slow
@pytest.mark.parametrize("lost", [0.10, 0.125, 0.15])
@pytest.mark.parametrize("deviations", [None, BENCHY_DEVIATIONS])
def test_the_error_hardly_depends_on_what_the_paper_leaves_open(lost: float, deviations: Any) -> None:
    assert 1.8 < fit_aging(BENCHY_SECONDS, lost=lost, deviations=deviations).error < 3.0


def test_light_takes_as_long_as_there_is_oxygen() -> None:
    assert replace(FRESH, oxygen=exp(-0.25)).seconds(56.8) == pytest.approx(56.8 * exp(-0.25))
