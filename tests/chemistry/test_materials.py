"""Materials: published values come back, every number names its source, and nothing is known beyond the data."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from vamgpu.chemistry.materials import Glass, Inhibitor, Liquid, Resin
from vamgpu.chemistry.materials.library import DATA
from vamgpu.chemistry.materials.resin import diffusion_length, wilke_chang
from vamgpu.errors import BadInput, MaterialError, OutsideData
from vamgpu.units import Pa_s, cm, kg_m3, nm

KINDS: dict[str, Any] = {"resins": Resin, "inhibitors": Inhibitor, "glasses": Glass, "liquids": Liquid}
BUNDLED = [(kind, name) for kind, model in KINDS.items() for name in model.names()]


def test_diffusivities_and_lengths_are_those_of_the_paper() -> None:
    resin = Resin.load("bisgma-tegdma-habi")
    assert resin.diffusivity("oxygen") == pytest.approx(3.27e-7, rel=2e-3)
    assert resin.diffusivity("lophyl") == pytest.approx(6.89e-8, rel=2e-3)
    assert diffusion_length(resin.diffusivity("oxygen"), 100.0) == pytest.approx(1.40e-2, rel=2e-3)
    assert diffusion_length(resin.diffusivity("lophyl"), 30.0) == pytest.approx(3.52e-3, rel=2e-3)


def test_wilke_and_chang_by_hand() -> None:
    found = wilke_chang(temperature=300.0, viscosity=1e-3 * Pa_s, solvent=100.0, solute=64.0, density=2000.0 * kg_m3)
    assert found == pytest.approx(7.4e-6 * 10.0 * 300.0 / 32.0**0.6, rel=1e-12)


@pytest.mark.parametrize("changed", ["temperature", "viscosity", "solvent", "solute", "density", "association"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_impossible_solutions_are_refused_by_name(changed: str, value: float) -> None:
    given = {"temperature": 293.0, "viscosity": 1e-6, "solvent": 400.0, "solute": 32.0, "density": 1e-9}
    with pytest.raises(BadInput, match=changed):
        wilke_chang(**(given | {changed: value}))


@pytest.mark.parametrize(
    ("material", "wavelength", "index"),
    [
        (Glass.load("fused-silica"), 587.6, 1.45846),
        (Glass.load("n-bk7"), 587.6, 1.5168),
        (Glass.load("borofloat33"), 587.6, 1.4714),
        (Glass.load("pmma"), 589.3, 1.4925),
        (Liquid.load("water"), 589.3, 1.33336),
        (Glass.load("duran"), 587.56, 1.473),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_indices_are_those_of_the_tables(material: Any, wavelength: float, index: float) -> None:
    assert material.index.at(wavelength * nm) == pytest.approx(index, abs=2e-4)


def test_resins_hold_what_their_papers_say() -> None:
    assert Resin.load("dudma-pegda").refraction(405 * nm) == 1.49962
    assert Resin.load("tmpta-ethylcellulose").absorption(442 * nm) == pytest.approx(2.2 / cm)
    assert Resin.load("tmpta-ethylcellulose").refraction(442 * nm) == 1.49
    viscosity = Resin.load("dudma-pegda").viscosity
    assert viscosity is not None and viscosity.value == pytest.approx(1.652 * Pa_s)


def test_k_becomes_an_absorption_per_length() -> None:
    assert Glass.load("n-bk7").absorption(400 * nm) == pytest.approx(4 * 3.14159265 * 1.0227e-8 / (400 * nm))


@pytest.mark.parametrize(("kind", "name"), BUNDLED)
def test_every_number_names_its_source(kind: str, name: str) -> None:
    def sources(value: Any) -> list[str]:
        if isinstance(value, BaseModel):
            return [text for field, v in value for text in ([v] if field == "source" and v else sources(v))]
        return [text for v in value for text in sources(v)] if isinstance(value, tuple) else []

    material = KINDS[kind].load(name)
    numbers = re.findall(r"^(?:value|index|terms|absorption|k) = ", (DATA / kind / f"{name}.toml").read_text(), re.M)
    assert len(sources(material)) >= len(numbers) > 0
    assert all("et al." in text or re.search(r"\b(19|20)\d\d\b", text) for text in sources(material))


def test_what_no_source_gives_is_absent_and_asked_for() -> None:
    resin = Resin.load("dudma-pegda")
    assert resin.molar_mass is None and resin.temperature is None and resin.oxygen is None
    with pytest.raises(MaterialError, match=r"temperature of DUDMA.*pass it"):
        resin.diffusivity("oxygen")
    assert resin.diffusivity("oxygen", temperature=293.15, molar_mass=500.0) > 3e-6


@pytest.mark.parametrize(
    ("ask", "range_"),
    [
        (lambda: Glass.load("n-bk7").index.at(250 * nm), "300 to 2500 nm"),
        (lambda: Glass.load("pmma").index.at(405 * nm), "420 to 1620 nm"),
        (lambda: Resin.load("dudma-pegda").refraction(450 * nm), "at 405 nm"),
        (lambda: Resin.load("tmpta-ethylcellulose").absorption(405 * nm), "at 442 nm"),
        (lambda: Glass.load("duran").absorption(300 * nm), "350 to 700 nm"),
        (lambda: Resin.load("bisgma-tegdma-habi").refraction(460 * nm), "no source"),
        (lambda: Resin.load("dudma-pegda").absorption(405 * nm), "no source"),
    ],
)
def test_wavelengths_outside_the_data_are_refused_with_the_range(ask: Any, range_: str) -> None:
    with pytest.raises(OutsideData, match=range_):
        ask()


OWN = """
name = "mine"
[viscosity]
value = "2 Pa s"
source = "measured by me, notebook 3"
[index]
form = "cauchy"
wavelength = ["380 nm", "700 nm"]
constant = 1.48
terms = [[0.005, -2.0]]
source = "measured by me, notebook 3"
"""


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(OWN)
    assert Resin.load(path).refraction(500 * nm) == pytest.approx(1.48 + 0.005 / 0.25)
    assert Resin.load(str(path)).name == "mine"


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('"2 Pa s"', '"2 mm"', r"viscosity\.value.*not 'mm'"),
        ('"2 Pa s"', '"-2 Pa s"', r"viscosity\.value.*> 0"),
        ('"2 Pa s"', "2.0", r"viscosity\.value.*in quotes"),
        ('source = "measured by me, notebook 3"\n[index]', "[index]", r"viscosity\.source"),
        ('name = "mine"', 'name = "mine"\ncolor = "red"', "color"),
        ('["380 nm", "700 nm"]', '["700 nm", "380 nm"]', r"index.*ascending"),
        ('["380 nm", "700 nm"]', '["380 nm"]', r"index.*first and the last"),
        ("constant = 1.48", "constant = 0.2", r"index.*at least 1"),
        ("constant = 1.48", "constant = nan", r"index\.constant"),
        ('form = "cauchy"', 'form = "conrady"', r"index\.form"),
        ("[viscosity]", "[viscosity", "not valid TOML"),
    ],
)
def test_wrong_files_are_refused_where_they_are_wrong(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    path = tmp_path / "mine.toml"
    assert old in OWN
    path.write_text(OWN.replace(old, new, 1))
    with pytest.raises(MaterialError, match=complaint):
        Resin.load(path)


def test_unknown_names_are_answered_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(MaterialError, match=r"did you mean 'dudma-pegda'"):
        Resin.load("dudma-pegdb")
    with pytest.raises(MaterialError, match="borofloat33"):
        Glass.load("../resins/dudma-pegda")
    with pytest.raises(MaterialError, match="cannot read"):
        Glass.load(tmp_path / "none.toml")
