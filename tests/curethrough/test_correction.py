"""Corrected doses keep to the constraint curves wherever the map says so; columns of every kind, on every device."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from profiling.curethrough_formulas import highest_dose
from vamgpu.backend.device import Device
from vamgpu.curethrough.correction import Correction, Corrector, correct
from vamgpu.curethrough.dose import column_dose, column_doses
from vamgpu.curethrough.feasibility import fastest, feasibility, least_void
from vamgpu.curethrough.layers import LayerPrinter
from vamgpu.curethrough.leastsquares import heights, least_squares
from vamgpu.curethrough.printer import Printer, build_up, die_down, levels_of
from vamgpu.curethrough.profile import Flat, Parallel
from vamgpu.curethrough.score import Group, features, grouped
from vamgpu.errors import BadInput
from vamgpu.units import mJ_cm3, mW_cm2

PRINTER = Printer(2.0, 576 * mJ_cm3, 0.05, 1000 / 3600, levels_of(100 * mW_cm2, 1 * mW_cm2))
GAMMA = Printer(0.8, 400 * mJ_cm3, 0.02, 0.1, levels_of(0.7, 0.0, lambda level: 0.01 + 0.99 * (level / 255.0) ** 2.2))

runs = st.lists(st.tuples(st.integers(1, 60), st.integers(1, 12)), min_size=1, max_size=20)


def column(features: list[tuple[int, int]], lead: int) -> np.ndarray:
    """``lead`` void slices, then features and the voids between them; the last feature ends the column."""
    parts = [np.zeros(lead, np.uint8)]
    for solid, void in features:
        parts += [np.full(solid, 255, np.uint8), np.zeros(void, np.uint8)]
    return np.concatenate(parts[:-1])


def within(printer: Printer, shown: np.ndarray, part: np.ndarray, tolerance: float, platform: bool = True) -> None:
    """Assert curves i to iii inside features and the critical dose outside, at borders and between them."""
    places = np.arange(len(shown) * 4) / 4 + 1e-6
    dose = column_dose(printer, shown, places)
    solid = np.zeros(len(places), bool)
    for upper, lower in np.flatnonzero(np.diff(np.pad(part >= 128, 1).astype(int))).reshape(-1, 2):
        own = (places >= upper) & (places < lower)
        solid |= own
        assert dose[own].min() >= 1.0 - tolerance
        above = build_up(places[own], lower, printer.phi_max, printer.eta) + tolerance
        if upper or not platform:
            above = np.minimum(above, die_down(places[own], upper, printer.phi_min, printer.eta) + tolerance)
        assert (dose[own] <= above + 2e-3 * above).all()
    if (~solid).any():
        assert dose[~solid].max() <= 1.0 + tolerance


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(features=runs, lead=st.integers(0, 30), tail=st.integers(0, 8), gamma=st.booleans(), dither=st.booleans(),
       finite=st.booleans())  # fmt: skip
def test_feasible_columns_keep_to_the_curves(
    features: list[tuple[int, int]], lead: int, tail: int, gamma: bool, dither: bool, finite: bool
) -> None:
    printer, part = GAMMA if gamma else PRINTER, column(features, lead)
    correction = Correction(printer, Flat(1.6) if finite else Flat(), tail=tail, dither=dither)
    corrector = Corrector(correction, (len(part), 1, 1), "numpy")
    shown = np.empty(corrector.slices, np.uint8)
    for block in corrector.run(part[:, None, None]):
        shown[block.start : block.start + block.table.shape[0]] = block.levels[:, 0, 0]
    full_tail = tail >= printer.build_up_height() / printer.slice_height
    if full_tail:
        assert not corrector.missed.any()
    if all(void >= 2 for _, void in features[:-1]) and full_tail:
        assert not corrector.closed.any()
    if feasibility(corrector, part[:, None, None]).feasible.all():
        within(printer, shown, part, 2.0 * correction.tolerance)


def test_light_begins_where_the_paper_says() -> None:
    part = column([(40, 1)], 20)
    shown = correct(Correction(PRINTER), part[:, None, None], "numpy")[:, 0, 0]
    assert len(shown) == 60 + 4 and (shown[60:63] >= 253).all() and 0 < shown[63] < 20  # 151 µm are 3.03 slices
    dose = column_doses(PRINTER, shown)
    assert dose[60] == pytest.approx(1.0, abs=PRINTER.tolerance) and dose[20] == pytest.approx(1.0, abs=2e-3)
    assert dose.max() == pytest.approx(float(highest_dose(40, PRINTER.phi_min, 6.25, 0.025)), rel=0.05)
    assert (shown[:20] == 0).all()


PROFILES = [Flat(1.5), Parallel(0.5, 2.0, 0.0625, 6.25), lambda back, front: 1.2 + 0.1 * front]


@pytest.mark.parametrize("profile", PROFILES)
def test_inner_profiles(profile: object) -> None:
    part = column([(60, 9), (50, 3)], 20)
    correction = Correction(PRINTER, profile, platform=False)  # type: ignore[arg-type]
    shown = correct(correction, part[:, None, None], "numpy")[:, 0, 0]
    within(PRINTER, shown, part, 2 * correction.tolerance, platform=False)
    dose = column_doses(PRINTER, shown)
    if isinstance(profile, Flat):
        assert np.abs(dose[50:70] - 1.5).max() <= 2 * correction.tolerance
    elif isinstance(profile, Parallel):
        middle = 45
        curves = build_up(middle, 80, 6.25, 0.025), die_down(middle, 20, 0.0625, 0.025)
        assert dose[middle] == pytest.approx(1.0 + 0.5 * (float(min(curves)) - 1.0), rel=5e-3)
    else:
        assert dose[40] == pytest.approx(1.3, abs=0.01)


def test_devices_write_the_same_slices(fast_device: Device) -> None:
    rng = np.random.default_rng(2)
    stack = np.repeat(rng.random((30, 6, 71)) < 0.5, 7, axis=0).astype(np.uint8) * 255
    correction = Correction(GAMMA)
    wanted, found = correct(correction, stack, "numpy"), correct(correction, stack, fast_device)
    assert (wanted != found).mean() < 1e-3


def test_speeds_of_the_map_are_the_limit() -> None:
    part = np.zeros((100, 1, 3), np.uint8)
    part[20:60, 0, 0], part[20:99, 0, 1] = 255, 255
    for speed_up, missing in ((0.999, 0), (1.01, 1)):
        start = Corrector(Correction(PRINTER, tail=0), part.shape, "numpy")
        for _ in start.run(part):
            pass
        limits = feasibility(start, part)
        assert np.isinf(limits.speed[0, 2]) and limits.missed[0, 1] == 1
        printer = PRINTER.at_speed(limits.speed[0, 1] * speed_up)
        again = Corrector(Correction(printer, tail=0), part.shape, "numpy")
        for _ in again.run(part):
            pass
        assert again.missed[0, 1] == missing
        feature = features_of(part[:, 0, 1])[0]
        assert fastest(PRINTER, feature, 100) == pytest.approx(limits.speed[0, 1])


def features_of(levels: np.ndarray) -> tuple[Group, ...]:
    """Features of one column [slice], front to back."""
    return grouped(features(PRINTER, levels[:, None], levels[:, None] >= 128))


def closed(printer: Printer, void: int, open_dose: float | None) -> int:
    """Voids that the correction itself finds closed, of one between two features."""
    part = column([(60, void), (60, 1)], 5)
    corrector = Corrector(Correction(printer, open_dose=open_dose), (len(part), 1, 1), "numpy")
    for _ in corrector.run(part[:, None, None]):
        pass
    return int(corrector.closed[0, 0])


@pytest.mark.parametrize("printer", [PRINTER, GAMMA, PRINTER.at_speed(0.8)], ids=["paper", "gamma", "fast"])
@pytest.mark.parametrize("open_dose", [None, 0.9, 0.5])
def test_the_shortest_void_that_opens_is_the_kernels(printer: Printer, open_dose: float | None) -> None:
    least = int(least_void(printer, open_dose))
    assert least >= 2
    # front and back side lie within half a level of the critical dose, which may take a slice more
    assert closed(printer, 1, open_dose) == 1 and closed(printer, least - 1, open_dose) == 1
    assert closed(printer, least + (open_dose is not None), open_dose) == 0


def test_a_void_of_one_slice_opens_at_no_speed() -> None:
    first, second = features_of(column([(20, 1), (20, 1)], 5))
    assert fastest(PRINTER, first, 50) == 0.0 and fastest(PRINTER, second, 50) > 0.0
    wider = features_of(column([(20, 6), (20, 1)], 5))[0]
    speed = fastest(PRINTER, wider, 55, 0.9)
    assert speed > 0 and least_void(PRINTER.at_speed(speed), 0.9) <= 6 < least_void(PRINTER.at_speed(1.03 * speed), 0.9)


def test_least_squares_is_equal_where_feasible_and_better_elsewhere() -> None:
    rng = np.random.default_rng(3)
    columns = []
    for n in range(40):
        lowest = 1 if n % 2 else 3
        features = [(int(rng.integers(3, 30)), int(rng.integers(lowest, 4))) for _ in range(4)]
        columns.append(np.resize(np.append(column(features, 3), np.zeros(200, np.uint8)), 150))
    part, correction = np.stack(columns, axis=1), Correction(PRINTER)
    levels, corrector = least_squares(correction, part), Corrector(correction, part[:, None].shape, "numpy")
    plain = np.concatenate([block.levels[:, 0].copy() for block in corrector.run(part[:, None])][::-1])
    fine = (corrector.missed + corrector.closed)[0] == 0
    assert fine.any() and (~fine).any()
    assert (levels[:, fine] == plain[:, fine]).all()
    wanted = np.concatenate([part, np.zeros((len(levels) - len(part), part.shape[1]), np.uint8)])
    before, after = (np.add(*heights(PRINTER, shown, wanted)) for shown in (plain, levels))
    assert (after <= before).all()
    assert after[~fine].sum() < 0.95 * before[~fine].sum()


@pytest.mark.parametrize(("make", "told"), [
    (lambda: Correction(None), "expected a Printer"),  # type: ignore[arg-type]
    (lambda: Correction(PRINTER, tail=1.5), "tail is 1.5"),  # type: ignore[arg-type]
    (lambda: Correction(PRINTER, tail=10**8), "0 to 65,536"),
    (lambda: Correction(PRINTER, threshold="x"), "threshold is 'x'"),  # type: ignore[arg-type]
    (lambda: correct(Correction(PRINTER), [[[0]]]), "slices are list"),  # type: ignore[arg-type]
    (lambda: Printer(1e-3, 0.5, 5.0, 1.0, PRINTER.light), "5000 absorption heights; expected at most 30"),
    (lambda: LayerPrinter(1e-3, 0.5, 5.0, 1.0, PRINTER.light), "5000 absorption heights; expected at most 30"),
])  # fmt: skip
def test_bad_input_is_named(make: Callable[[], object], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        make()


def test_hopeless_printers_are_refused() -> None:
    bright = Printer(2.0, 0.03, 0.05, 1000 / 3600, levels_of(1.0, 0.01))
    with pytest.raises(BadInput, match="nothing can stay uncured"):
        Correction(bright)
    with pytest.raises(BadInput, match="print slower"):
        Correction(PRINTER.at_speed(10.0))
    with pytest.raises(BadInput, match="never|rise"):
        Printer(2.0, 0.5, 0.05, 1.0, tuple(reversed(PRINTER.light)))
