"""Dose of a stack: against closed sums, anywhere along the print, on every device, and what the paper states."""

from __future__ import annotations

import numpy as np
import pytest

from profiling.curethrough_formulas import closed_sum, doses, highest_dose, highest_place
from vamgpu.backend.device import Device
from vamgpu.curethrough.dose import Judge, RunningDose, blocks, column_dose, column_doses
from vamgpu.curethrough.layers import LayerPrinter
from vamgpu.curethrough.printer import Printer, build_up, die_down, levels_of
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.kernels.curethrough import add
from vamgpu.units import mJ_cm3, mW_cm2, um

HOUR = 3600.0


def printer(eta: float = 0.025, dark: float = 1.0, full: float = 100.0) -> Printer:
    return Printer(2.0, 576 * mJ_cm3, eta * 2.0, 1000 / HOUR, levels_of(full * mW_cm2, dark * mW_cm2))


def random_stack(slices: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (slices, 3, 21)).astype(np.uint8)


@pytest.mark.parametrize("eta", [0.0002, 0.002, 0.025, 0.45])
def test_streamed_doses_are_the_closed_sum(device: Device, eta: float) -> None:
    one, stack = printer(eta), random_stack(3000 if eta < 0.01 else 150)
    found: dict[int, np.ndarray] = {}
    for start, block in doses(one, stack, device):
        found |= {start + n: picture for n, picture in enumerate(block)}
    assert sorted(found) == list(range(len(stack)))
    for n in (0, 1, 31, 32, 70, len(stack) - 1):
        wanted = closed_sum(one, stack, n)
        assert np.abs(found[n] - wanted).max() <= 1e-5 * wanted.max()


@pytest.mark.every_device
def test_sums_over_thousands_of_thin_slices_keep_what_they_round_off(device: Device) -> None:
    """Within four roundings of float32: of light, decay and two sums; sums that forget theirs come to 16 to 30."""
    one, levels = printer(2e-4), np.array([255, 200, 128, 77, 1], np.uint8)
    stack = np.broadcast_to(np.resize(levels, (1, 71)), (3000, 1, 71))
    wanted, most = column_doses(one, stack), 4 * 2.0**-24
    for start, block in doses(one, stack, device):
        np.testing.assert_allclose(block, wanted[start : start + len(block)], rtol=most)
    judge = Judge(one, (1, 71), device)
    for start, stop in blocks(len(stack)):
        judge.step(stack[start:stop], stack[start:stop])
    np.testing.assert_allclose(judge.state.numpy()[0], wanted[0], rtol=most)


def test_the_definition_keeps_what_float32_rounds_off() -> None:
    """The reference device computes in float64, where a sum that forgets its rounding would show nowhere."""
    change, state = np.full(1, 0.1, np.float32), np.zeros((2, 1), np.float32)
    for _ in range(10_000):
        add(state, change)
    assert state.dtype == np.float32
    assert state[0] == np.float32(10_000 * float(change[0]))


@pytest.mark.parametrize("width", [64, 71, 144])
def test_rows_of_any_place_in_memory(device: Device, width: int) -> None:
    one = printer()
    stack = np.random.default_rng(4).integers(0, 256, (33, 3, width)).astype(np.uint8)
    wanted = column_doses(one, stack)
    for start, block in doses(one, stack, device):
        np.testing.assert_allclose(block, wanted[start : start + len(block)], rtol=0, atol=1e-5 * wanted.max())


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.9, 1.0])
def test_doses_between_borders(device: Device, fraction: float) -> None:
    one, stack = printer(0.3), random_stack(40)
    for start, block in doses(one, stack, device, fraction):
        for n in (0, len(block) - 1):
            wanted = closed_sum(one, stack, start + n + fraction)
            assert np.abs(block[n] - wanted).max() <= 1e-5 * max(wanted.max(), 0.1)


def test_dose_is_continuous_and_matches_the_sum_at_any_place() -> None:
    one, column = printer(0.4), random_stack(30)[:, 0, 0]
    places = np.linspace(0.0, 30.0, 301)
    found = column_dose(one, column, places)
    np.testing.assert_allclose(found, [closed_sum(one, column, z) for z in places], rtol=1e-12, atol=1e-14)
    for border in range(1, 30):
        below, above = column_dose(one, column, [border - 1e-9, border + 1e-9])
        assert abs(below - above) < 1e-7
    np.testing.assert_allclose(column_dose(one, column, np.arange(31)), column_doses(one, column), rtol=1e-12)


@pytest.mark.parametrize("fraction", [0.0, 0.5, 0.999])
def test_layers_follow_their_sum(device: Device, fraction: float) -> None:
    one = LayerPrinter(0.11, 576 * mJ_cm3, 0.05, 2.0, levels_of(1.0, 0.01))
    stack = random_stack(45)
    for start, block in doses(one, stack, device, fraction):
        for n in range(1, len(block)):
            wanted = closed_sum(one, stack, start + n - fraction)
            assert np.abs(block[n] - wanted).max() <= 1e-5 * wanted.max()


def test_dark_level_leaves_what_the_paper_states() -> None:
    one = printer()
    assert one.phi_min * one.critical_dose / mJ_cm3 == pytest.approx(36.0, rel=1e-12)
    dark = np.zeros(3000, np.uint8)
    assert column_doses(one, dark)[0] == pytest.approx(one.phi_min, rel=1e-9)


def test_height_of_full_light_to_the_critical_dose() -> None:
    one = printer()
    assert one.phi_max == pytest.approx(6.25)
    assert one.build_up_height() / um == pytest.approx(151.4, abs=0.05)
    column = np.full(1000, 255, np.uint8)
    assert column_dose(one, column, 1000 - one.build_up_height() / one.slice_height) == pytest.approx(1.0, rel=1e-9)


def test_constraint_curves_meet_where_they_should() -> None:
    low, high, eta = 0.0625, 6.25, 0.025
    for upper, lower in ((10.0, 12.0), (100.0, 120.0), (3.0, 403.0)):
        place = highest_place(upper, lower, low, high, eta)
        dose = float(highest_dose(lower - upper, low, high, eta))
        assert upper < place < lower
        assert float(build_up(place, lower, high, eta)) == pytest.approx(dose, rel=1e-9)
        assert float(die_down(place, upper, low, eta)) == pytest.approx(dose, rel=1e-9)


def test_dead_zone_takes_its_share() -> None:
    one = printer()
    behind = Printer(2.0, one.critical_dose, 0.05, one.speed, one.light, dead_zone=0.2)
    np.testing.assert_allclose(behind.phi, one.phi * 10**-0.1, rtol=1e-12)


def test_heights_count_parts_of_slices(device: Device) -> None:
    one = printer(dark=0.0)
    wanted = np.zeros((90, 2, 5), np.uint8)
    wanted[40:60] = 255
    judge = Judge(one, (2, 5), device)
    for start, stop in blocks(90):
        judge.step(wanted[start:stop], wanted[start:stop])
    fine = np.linspace(0, 90, 90001)[:-1] + 5e-4
    cured = column_dose(one, wanted[:, 0, 0], fine) >= 1.0
    inside = (fine >= 40) & (fine < 60)
    np.testing.assert_allclose(judge.over(), (cured & ~inside).mean() * 90 * 0.05, rtol=1e-3)
    np.testing.assert_allclose(judge.under(), (~cured & inside).mean() * 90 * 0.05, rtol=1e-3)
    assert judge.under().max() == pytest.approx(one.build_up_height(), rel=1e-3)


def test_blocks_are_checked() -> None:
    exposure = RunningDose(printer(), (3, 21), "numpy")
    with pytest.raises(BadInput, match="uint16"):
        exposure.step(np.zeros((2, 3, 21), np.uint16))
    with pytest.raises(ShapeMismatch, match="32"):
        exposure.step(np.zeros((33, 3, 21), np.uint8))
