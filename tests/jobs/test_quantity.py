"""Numbers with units."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vamgpu.quantity import SPELLINGS, parse
from vamgpu.units import NAMES


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("12.4 mm", "a length", 12.4),
        ("67um", "a length", 0.067),
        ("67 µm", "a length", 0.067),
        ("1_000 um", "a length", 1.0),
        (" 1.5e1 mm ", "a length", 15.0),
        ("0.5 1/cm", "an absorption", 0.05),
        ("0.05 /mm", "an absorption", 0.05),
        ("5 mW/cm2", "an irradiance", 0.05),
        ("0.05 mW/mm²", "an irradiance", 0.05),
        ("0.065 W/cm^2", "an irradiance", 0.65),
        ("65 mW cm⁻²", "an irradiance", 0.65),
        ("40 mJ/cm³", "a dose", 0.04),
        ("40 mJ/cm3", "a dose", 0.04),
        ("40mJ/cm^3", "a dose", 0.04),
        ("40 mJ cm-3", "a dose", 0.04),
        ("40 mJ·cm⁻³", "a dose", 0.04),
        ("0.1 J/cm^3", "a dose", 0.1),
        ("0.1 J/cm3", "a dose", 0.1),
        ("0.04 mJ/mm³", "a dose", 0.04),
        ("0.05 mm⁻¹", "an absorption", 0.05),
        ("0.5 cm^-1", "an absorption", 0.05),
        ("25 μm", "a length", 0.025),
        ("3.27e-7 mm²/s", "a diffusivity", 3.27e-7),
        ("1100 kg/m³", "a density", 1.1e-9),
        ("8 mol/m³", "a concentration", 8.0),
        ("48 mm/min", "a speed", 0.8),
        ("180 deg", "an angle", 3.141592653589793),
        ("266 Hz", "a rate", 266.0),
        ("5 ms", "a time", 0.005),
        ("1.1 g/cm3", "a density", 1.1e-9),
        ("1.1 g/mL", "a density", 1.1e-9),
        ("43.7 Pa s", "a viscosity", 43.7e-6),
        ("500 mPa·s", "a viscosity", 0.5e-6),
        ("500 cP", "a viscosity", 0.5e-6),
    ],
)
def test_units_become_mm_s_and_mj(text: str, kind: str, value: float) -> None:
    assert parse(text, kind) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    "text", ["12.4", "mm", "", "12.4 s", "12.4 mm mm", "nan mm", "-1 mm", "0 mm", "1e400 mm", 12.4, True]
)
def test_what_is_no_length_is_refused_with_an_example(text: object) -> None:
    with pytest.raises(ValueError, match=r"expected a length.*12\.4 mm"):
        parse(text, "a length")


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("65 mW", "an irradiance", r"expected an irradiance in mW/cm2, W/cm2, mW/mm2, not 'mW': .*65 mW/cm2"),
        ("65 mJ/cm2", "an irradiance", "not 'mJ/cm2'"),
        ("100 mJ/cm²", "a dose", r"expected a dose in mJ/cm3, J/cm3, mJ/mm3, not 'mJ/cm²': .*100 mJ/cm3"),
        ("100", "a dose", "not a number without a unit"),
        ("0.2 in", "a length", r"expected a length .*not 'in' \(0\.2 × 25\.4 mm = 5\.08 mm\): .*like \"5\.08 mm\""),
        ("0.01in", "a length", r"0\.01 × 25\.4 mm = 0\.254 mm"),
        ("5 mil", "a length", r"= 0\.127 mm"),
        ("100 mJ cm-2", "a dose", "not 'mJ cm-2'"),
    ],
)
def test_a_dose_is_no_exposure_and_an_irradiance_no_power(text: str, kind: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse(text, kind)


def test_nothing_is_allowed_where_it_makes_sense() -> None:
    assert parse("0 1/mm", "an absorption", zero=True) == 0.0


@given(st.floats(1e-6, 1e6), st.sampled_from(SPELLINGS["a length"]))
def test_every_length_reads_back(value: float, unit: str) -> None:
    assert parse(f"{value!r} {unit}", "a length") == pytest.approx(value * NAMES[unit], rel=1e-12)
