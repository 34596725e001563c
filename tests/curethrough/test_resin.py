"""Fits of working curves and gray levels."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from vamgpu.curethrough.resin import WorkingCurve, fit_gray, read_gray
from vamgpu.curethrough.spectrum import LampSpectrum
from vamgpu.errors import BadInput, SliceWarning, StorageError
from vamgpu.storage.tables import read_columns

H, GEL = 2.0, 0.115


def heights(exposure: np.ndarray) -> np.ndarray:
    return H * np.log10(exposure * np.log(10) / (GEL * H))


def test_exact_plugs_give_the_resin_back() -> None:
    exposure = np.array([0.2, 0.5, 1.0, 2.0])
    curve = WorkingCurve.fit(exposure, heights(exposure))
    assert curve.absorption_height.value == pytest.approx(H, rel=1e-9)
    assert curve.gel_dose.value == pytest.approx(GEL, rel=1e-9)
    np.testing.assert_allclose(curve.height(exposure), heights(exposure), rtol=1e-9)


@pytest.mark.parametrize("confidence", [0.8, pytest.param(0.95, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore:the heights do not follow")
def test_intervals_hold_as_often_as_they_say(confidence: float) -> None:
    rng, held = np.random.default_rng(1), np.zeros(2)
    exposure = np.repeat(np.geomspace(0.2, 3.0, 6), 2)
    for _ in range(600):
        curve = WorkingCurve.fit(exposure, heights(exposure) + rng.normal(0, 0.05, exposure.size), confidence)
        held += [curve.absorption_height.low <= H <= curve.absorption_height.high,
                 curve.gel_dose.low <= GEL <= curve.gel_dose.high]  # fmt: skip
    assert np.abs(held / 600 - confidence).max() < 0.04


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the heights do not follow")
def test_plugs_that_did_not_gel_count_as_such() -> None:
    """Left out, they make both numbers too small, and fitted as heights by 20 % and 27 %."""
    rng, held, found = np.random.default_rng(3), np.zeros(2), []
    exposure = np.repeat(np.geomspace(0.03, 3.0, 10), 2)
    for _ in range(40):
        curve = WorkingCurve.fit(exposure, np.maximum(heights(exposure) + rng.normal(0, 0.15, exposure.size), 0.0))
        found.append((curve.absorption_height.value / H, curve.gel_dose.value / GEL))
        held += [curve.absorption_height.low <= H <= curve.absorption_height.high,
                 curve.gel_dose.low <= GEL <= curve.gel_dose.high]  # fmt: skip
    assert 4 <= curve.uncured <= 8
    assert np.abs(np.mean(found, 0) - 1.0).max() < 0.02
    assert held.min() >= 35


def test_exact_plugs_and_one_that_did_not_gel_give_the_resin_back() -> None:
    exposure = np.array([0.01, 0.2, 0.5, 1.0, 2.0])
    curve = WorkingCurve.fit(exposure, np.maximum(heights(exposure), 0.0))
    assert curve.absorption_height.value == pytest.approx(H, rel=1e-5) and curve.uncured == 1
    assert curve.gel_dose.value == pytest.approx(GEL, rel=1e-5)


def test_heights_that_do_not_follow_the_law_are_warned_of() -> None:
    exposure = np.geomspace(0.2, 3.0, 8)
    noise = np.random.default_rng(0).normal(0, 0.01, 8)
    with pytest.warns(SliceWarning, match="grow less at high exposures"):
        WorkingCurve.fit(exposure, 1.5 * heights(exposure) ** 0.6 + noise)
    lost = heights(exposure) + noise
    lost[6] = 0.0
    with pytest.warns(SliceWarning, match="1 plugs of height 0 got exposures for which the curve gives up to 2"):
        WorkingCurve.fit(exposure, lost)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        WorkingCurve.fit(exposure, heights(exposure) + noise)


@pytest.mark.parametrize(
    "text",
    [
        "time_s,height_mm\n1,{0}\n3,{1}\n9,{2}\n",
        "sep=;\nTime [s];Cure depth [µm];Notes;\n1,0;{3};first;\n3,0;{4};;\n9;{5};see page 3;\n",
        "# by hand\nexposure time (ms)\tsd (um)\theight (um)\n1000\t9\t{3}\n3000\t9\t{4}\n\n9000\t9\t{5}\n",
        "Dose [mJ/cm²] | Depth [mm] | note\n30 | {0} | a\n90 | {1} | 7\n270 | {2} |\n",
        "exposure_mJ_cm2   height_mm\n30   {0}\n90   {1}\n270   {2}\n",
        "exposure_mj_cm2,depth_um,Zmin [mm]\n30,{3},0\n90,{4},0\n270,{5},0\n",
        "Time [min]\tIrradiance [mW cm^-2]\theight min\theight_mm\n.0166666666666666667\t30\t7\t{0}\n.05\t30\t8\t{1}\n"
        ".15\t30\t9\t{2}\n",
        "Irradiance (W/m²),t/min,z/mm\n300,0.016666666666666667,{0}\n300,0.05,{1}\n300,0.15,{2}\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
def test_tables_of_spreadsheets_are_read(text: str, encoding: str, tmp_path: Path) -> None:
    z = heights(np.array([0.3, 0.9, 2.7]))
    file = tmp_path / "plugs.csv"
    file.write_bytes(text.format(*z, *1000 * z).replace("\n", "\r\n").encode(encoding))
    curve = WorkingCurve.read(file, irradiance=0.3)
    assert curve.absorption_height.value == pytest.approx(H, rel=1e-9)
    assert curve.gel_dose.value == pytest.approx(GEL, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("time_s,a_mm,b_mm\n1,1,1\n", "columns a_mm, b_mm; expected one height"),
        ("time_s,height\n1,1\n", "columns time_s, height; expected height_mm"),
        ("height_mm,volts\n1,1\n", "expected exposure_mJ_cm2 or time_s"),
        ("time_s,height_mm\n1,1,1\n", "line 2 has 3 values; expected 2"),
        ("time_s,height_Mm\n1,1\n", "the column 'height_Mm'; expected a unit of mm, um, cm: write it in these letters"),
        ("time_s,height_mm,I [MW/cm2]\n1,1,1\n", r"column 'I \[MW/cm2\]'; expected a unit of mW/mm2, mW/cm2"),
        ("exposure_MJ_cm2,height_mm\n1,1\n", "column 'exposure_MJ_cm2'; expected a unit of mJ/mm2"),
        ("min,height_mm\n1,1\n", "columns min, height_mm; expected exposure_mJ_cm2 or time_s"),
        ("dose_min,height_mm\n1,1\n", "columns dose_min, height_mm; expected exposure_mJ_cm2 or time_s"),
        ("time_s;height_mm\n1;none\n", "line 2: could not convert .* in 'height_mm'"),
    ],
)
def test_tables_without_what_is_needed_say_so(text: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "plugs.csv").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=told):
        WorkingCurve.read(tmp_path / "plugs.csv", 0.3)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("time_s,height_mm\n\n1,nan\n", "line 3 holds NaN"),
        ("time_s,height_mm\n1,1\n\n2,x\n", "line 4: could not"),
        ("time_s,time_s\n1,1\n", "column .time_s. more than once"),
    ],
)
def test_columns_name_the_line(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "plugs.csv").write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=told):
        read_columns(tmp_path / "plugs.csv")


def test_csv(tmp_path: Path) -> None:
    seconds = np.array([1.0, 3.0, 9.0, 20.0])
    file = tmp_path / "plugs.csv"
    rows = [f"{t},{z}" for t, z in zip(seconds, heights(seconds * 0.3), strict=True)]
    file.write_text("\n".join(["time_s,height_mm", *rows]))
    assert WorkingCurve.read(file, irradiance=0.3).gel_dose.value == pytest.approx(GEL, rel=1e-9)
    with pytest.raises(BadInput, match="irradiance"):
        WorkingCurve.read(file)
    file.write_text("time_s,height_mm\n1,2\n3,much\n")
    with pytest.raises(BadInput, match="line 3"):
        read_columns(file)
    with pytest.raises(StorageError):
        read_columns(tmp_path / "none.csv")


def test_too_few_or_falling_plugs_are_refused() -> None:
    with pytest.raises(BadInput, match="3"):
        WorkingCurve.fit([1.0, 2.0], [1.0, 2.0])
    with pytest.raises(BadInput, match="grow"):
        WorkingCurve.fit([1.0, 2.0, 4.0], [3.0, 2.0, 1.0])


def test_gray_fit_rises_and_ends_at_the_readings(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    levels = np.linspace(0, 255, 18).astype(int)
    truth = np.where(levels < 100, 0.01 + 0.001 * levels, 0.11 + 0.9 * ((levels - 100) / 155.0) ** 2)
    noisy = np.repeat(truth, 5) + rng.normal(0, 0.004, 90)
    fit = fit_gray(np.repeat(levels, 5), np.maximum(noisy, 0))
    table = np.array(fit.table())
    assert table.shape == (256,) and (np.diff(table) >= 0).all()
    assert np.abs(fit(levels) - truth).max() < 0.01 and fit.spread == pytest.approx(0.004, rel=0.3)
    file = tmp_path / "gray.csv"
    rows = [f"{a},{100 * b}" for a, b in zip(levels, truth, strict=True)]
    file.write_text("\n".join(["level,intensity_mW_cm2", *rows]))
    np.testing.assert_allclose(read_gray(file)(levels), truth, atol=1e-9)
    with pytest.raises(BadInput, match="0 to 255"):
        fit_gray([0, 100], [0.0, 1.0])


def lamp_heights(exposure: np.ndarray, light: np.ndarray, absorption: np.ndarray) -> np.ndarray:
    """Depth at which the dose Σ E·w·μ·exp(−μ z) falls to D_gel, by bisection; 0 where the surface does not gel."""
    shares = light / light.sum()
    low, high = np.zeros_like(exposure), np.full_like(exposure, 100.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        dose = exposure * (shares * absorption * np.exp(-absorption * middle[:, None])).sum(axis=1)
        low, high = np.where(dose > GEL, middle, low), np.where(dose > GEL, high, middle)
    return low


@pytest.mark.parametrize("unit", [1.0, 0.4343])
def test_a_lamp_of_several_wavelengths_gives_the_resin_back(unit: float, tmp_path: Path) -> None:
    light, absorption = np.array([1.0, 3.0, 2.0, 0.5]), np.array([4.0, 1.5, 0.4, 0.1])
    mean = float(light @ absorption / light.sum())
    exposure = np.geomspace(0.02, 5.0, 12)
    z = lamp_heights(exposure, light, absorption)
    assert 1 <= (z == 0).sum() <= 4
    rows = "".join(f"{nm};{a};{b * unit}\n" for nm, a, b in zip((365, 385, 405, 425), light, absorption, strict=True))
    (tmp_path / "lamp.csv").write_text("wavelength_nm;light;absorption\n" + rows)
    lamp = LampSpectrum.read(tmp_path / "lamp.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        curve = WorkingCurve.fit(exposure, z, lamp=lamp)
    assert curve.absorption_height.value == pytest.approx(np.log(10) / mean, rel=2e-3)
    assert curve.gel_dose.value == pytest.approx(GEL, rel=2e-3)
    np.testing.assert_allclose(curve.height(exposure)[z > 0], z[z > 0], atol=2e-3)
    with pytest.warns(SliceWarning, match="grow more at high exposures.*one wavelength"):
        WorkingCurve.fit(exposure, z)


def test_one_wavelength_is_the_law(tmp_path: Path) -> None:
    exposure = np.array([0.05, 0.2, 0.5, 1.0, 2.0])
    rng = np.random.default_rng(2)
    z = np.maximum(heights(exposure) + rng.normal(0, 0.02, 5), 0.0)
    one, plain = WorkingCurve.fit(exposure, z, lamp=LampSpectrum([2.0], [0.7])), WorkingCurve.fit(exposure, z)
    for found, expected in ((one.absorption_height, plain.absorption_height), (one.gel_dose, plain.gel_dose)):
        assert (found.value, found.low, found.high) == pytest.approx(
            (expected.value, expected.low, expected.high), rel=1e-3
        )


@pytest.mark.parametrize("light", [[1.0, 0.0], [1.0, 1e-12]], ids=["none", "next to none"])
def test_a_wavelength_that_is_absorbed_at_once_changes_nothing(light: list[float]) -> None:
    exposure = np.array([0.2, 0.5, 1.0, 2.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lamp = LampSpectrum(light, [1.0, 100.0])
        np.testing.assert_allclose(lamp.depth([0.1, 1.5]), [0.1, 1.5], atol=1e-8)
        curve = WorkingCurve.fit(exposure, heights(exposure), lamp=lamp)
    assert curve.absorption_height.value == pytest.approx(H, rel=1e-6)


@pytest.mark.parametrize(
    ("light", "absorption", "told"),
    [([1.0], [1.0, 2.0], "one of each for every wavelength"), ([1.0, -1.0], [1.0, 1.0], "finite and 0 or more"),
     ([1.0, 0.0], [0.0, 3.0], "absorbs none of the lamp's light")],
)  # fmt: skip
def test_spectra_that_are_none_are_refused(light: list[float], absorption: list[float], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        LampSpectrum(light, absorption)


def test_a_spectrum_without_its_columns_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("nm,power\n405,1\n")
    with pytest.raises(BadInput, match="has columns nm, power; expected light and absorption"):
        LampSpectrum.read(tmp_path / "a.csv")
