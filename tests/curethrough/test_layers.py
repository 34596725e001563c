"""Layer by layer: sawtooth, correction, and what no correction can avoid."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.curethrough.correction import Correction, Corrector, correct
from vamgpu.curethrough.dose import Judge, blocks, column_dose, column_doses
from vamgpu.curethrough.layers import LayerPrinter
from vamgpu.curethrough.printer import levels_of
from vamgpu.errors import BadInput
from vamgpu.units import mJ_cm3, mW_cm2, um

CRITICAL = 576 * mJ_cm3


def printer(dark: float = 1.7, exposure: float = 1.02) -> LayerPrinter:
    full = 100 * mW_cm2
    needed = CRITICAL * 0.11 * 10.0 ** (0.05 / 0.11) / (full * np.log(10.0))  # S53
    return LayerPrinter(0.11, CRITICAL, 0.05, exposure * needed, levels_of(full, dark * mW_cm2))


def part() -> np.ndarray:
    stack = np.zeros((80, 2, 3), np.uint8)
    stack[20:45], stack[55:70] = 255, 255
    return stack


def test_dose_falls_along_a_sawtooth() -> None:
    one = printer()
    assert 10.0**one.eta == pytest.approx(2.848, abs=5e-4)  # S55, greatest over least dose of a layer
    column = part()[:, 0, 0]
    low, high = column_dose(one, column, [30 + 1e-9, 30])
    assert high / low == pytest.approx(1.0 + one.phi[-1] / low, rel=1e-6)
    top, far = column_dose(one, column, [30, 29 + 1e-9])
    assert top / far == pytest.approx(10.0**one.eta, rel=1e-6)


def test_every_layer_gets_its_dose_and_no_more(device: Device) -> None:
    one, stack = printer(), part()
    corrector = Corrector(Correction(one), stack.shape, device)
    shown = np.empty_like(stack)
    for block in corrector.run(stack):
        shown[block.start : block.start + block.table.shape[0]] = block.levels
    assert not corrector.missed.any()
    far = column_doses(one, shown)[:-1] * (1.0 - one.decay)  # at the far edge of every layer
    solid = stack[:, 0, 0] > 0
    tolerance = one.tolerance * (1.0 - one.decay) + 1e-5
    assert np.abs(far[solid] - 1.0).max() <= tolerance


def test_short_exposures_miss(device: Device) -> None:
    corrector = Corrector(Correction(printer(exposure=0.9)), part().shape, device)
    for _ in corrector.run(part()):
        pass
    assert (corrector.missed == 2).all()


def test_cure_through_that_nothing_avoids() -> None:
    one = printer(exposure=1.0)
    paced = LayerPrinter(0.11, CRITICAL, 0.05, 0.05 / (1000 / 3600), one.light)  # the slices of 1,000 mm/h
    assert paced.least_cure_through / um == pytest.approx(5.0, abs=0.1)
    assert one.least_cure_through == pytest.approx(0.11 * np.log10(1.7 / 100 * 10 ** (0.05 / 0.11) + 1), rel=1e-9)
    stack = part()[:, :1, :1]
    shown = correct(Correction(printer()), stack, "numpy")
    judge = Judge(printer(), (1, 1), "numpy")
    for start, stop in blocks(len(stack)):
        judge.step(shown[start:stop], stack[start:stop])
    assert judge.over()[0, 0] == pytest.approx(2 * printer().least_cure_through, rel=0.15)
    plain = Judge(printer(), (1, 1), "numpy")
    for start, stop in blocks(len(stack)):
        plain.step(stack[start:stop], stack[start:stop])
    assert plain.over()[0, 0] > 8 * judge.over()[0, 0]


def test_dark_level_that_cures_is_refused() -> None:
    with pytest.raises(BadInput, match="nothing can stay uncured"):
        Correction(printer(dark=60.0))
