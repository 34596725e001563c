"""Job files reach what Python does: every vessel, light, wrapper, method, chemistry and two colors."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend import open_device
from vamgpu.chemistry.diffusion import Diffusion
from vamgpu.chemistry.materials.resin import Resin
from vamgpu.errors import BadInput, JobError
from vamgpu.jobs.build import projection_of, target_of, with_diffusion
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.jobs.web import WebJob
from vamgpu.methods import METHODS, GeneralizedLogistic, SurfaceRamp
from vamgpu.methods.dual import LeastSquares
from vamgpu.operators.compose import Composed
from vamgpu.optics.index_field import FormulaField
from vamgpu.printing.folder import load_frames
from vamgpu.schema.registry import FAMILIES, load
from vamgpu.units import deg, nm

HEAD = JOB[: JOB.index("[beam]")] + '[beam]\npitch = "600 um"\n'
SMALL = ["target.pitch=600 um", "turntable.angles=12", "solve.iterations=2", "solve.device=cpu"]
ROUND = 'kind = "vial"\nradius = "12.4 mm"\nwall = "1 mm"\nresin_index = 1.5\nwall_index = 1.47\n'
VIAL = vam.Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.47)
DOUBLE = ROUND.replace('"vial"', '"double walled"') + 'gap = "1 mm"\nliquid_index = 1.36\ninner_wall = "0.5 mm"\n'
VAT = vam.Vat(width=30.0, radius=13.0, absorption=0.05)
WET = 'kind = "vat"\nwidth = "30 mm"\nradius = "13 mm"\nabsorption = "0.05 1/mm"\n'
GRADED = 'radius = "12.4 mm"\nwall = "1 mm"\nwall_index = 1.47\nrays = 65\nrows = 33\n'
FORMULA = FormulaField((1.0, 1.0, 0.0), (2.25, -1e-4))


def built(text: str, folder: Path = Path(), name: str | None = "numpy") -> Any:
    job = Job.parse(HEAD + text, SMALL, folder=folder)
    device = open_device(name)
    return with_diffusion(job.file, projection_of(job.file, target_of(job, device), device, folder), folder)


VESSELS = {
    f'kind = "fan"\nthrow = "300 mm"\n[vessel.vessel]\n{ROUND}': vam.Fan(VIAL, throw=300.0),
    f'kind = "misaligned"\noffset = "-0.3 mm"\ntilt = "2 deg"\n[vessel.vessel]\n{ROUND}': vam.Misaligned(
        VIAL, -0.3, 2 * deg
    ),
    f'kind = "occluded"\nacross = "2 mm"\ntransmittance = 0.1\n[vessel.vessel]\n{ROUND}': vam.Occluded(
        VIAL, 2.0, transmittance=0.1
    ),
    f'kind = "graded"\n{GRADED}[vessel.resin]\nweights = [1.0, 1.0, 0.0]\nabove = [2.25, -1e-4]\n': vam.GradedVial(
        12.4, 1.0, FORMULA, 1.47, rays=65, rows=33
    ),
    DOUBLE: vam.DoubleWalledVial(
        radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.47, gap=1.0, liquid_index=1.36, inner_wall=0.5
    ),
    'kind = "square"\nwidth = "30 mm"\nwall = "1 mm"\nwall_index = 1.52\ntilt = "-2 deg"\n'
    f'liquid_absorption = "0.01 1/mm"\n[vessel.vessel]\n{ROUND}bath_index = 1.36\n': vam.SquareBath(
        replace(VIAL, bath_index=1.36), 30.0, 1.0, 1.52, tilt=-2 * deg, liquid_absorption=0.01
    ),
    ROUND: VIAL,
}


@pytest.mark.slow
@pytest.mark.parametrize("text", VESSELS)
def test_every_vessel(text: str) -> None:
    A = built(f"[vessel]\n{text}")
    assert isinstance(A, vam.Projection) and A.vessel == VESSELS[text]


LIGHTS = {
    'kind = "cone"\nthrow = "200 mm"\n': vam.Cone(throw=200.0),
    f'kind = "inclined"\nelevation = "20 deg"\n[light.vessel]\n{WET}': vam.Inclined(VAT, elevation=20 * deg),
    ROUND: VIAL,
}


@pytest.mark.parametrize("text", LIGHTS)
def test_every_light_past_an_axis_that_wobbles(text: str) -> None:
    A = built(f'[light]\n{text}[wobble]\nradius = "50 um"\nphase = "90 deg"\n')
    wanted = vam.Wobble.circle(0.05, 90 * deg, A.motion)
    assert isinstance(A, vam.Oblique) and A.light == LIGHTS[text] and A.wobble is not None
    assert np.array_equal(A.wobble.across, wanted.across) and np.array_equal(A.wobble.along, wanted.along)
    across, along, _ = A.grid.axes()
    height = 0.5 * (A.beam.pixels[1] - 1) * A.beam.pitch
    x, y = (part[np.hypot(*np.meshgrid(across, along)) < 5.5] for part in np.meshgrid(across, along))
    light: Any = A.light
    lift, stretch, _ = light.rows(x, y) if hasattr(light, "plane") else (0.0 * x, 1.0 + 0.0 * x, x)
    assert np.all(np.abs(lift) + 0.5 * 11.5 * stretch < height)  # pixels that the job did not say cover the part


def test_wrappers_go_around_the_projector_in_their_order() -> None:
    A = built(
        '[wobble]\nacross = "50 um"\n[defocus]\nfwhm = "0.6 mm"\ndepth_of_focus = "20 mm"\nfocus = "-1 mm"\n'
        'tolerance = 0.05\n[tiles]\nrows = 12\noverlap = 2\n[resin.diffusion]\ndiffusivity = "1e-4 mm2/s"\n'
        'seconds = "20 s"\n'
    )
    assert isinstance(A, Composed) and A.inner.diffusion == Diffusion(1e-4, 20.0)  # type: ignore[attr-defined]
    tiles: Any = A.outer
    assert isinstance(tiles, vam.Tiles) and tiles.range.beam.pixels[1] == 12 and tiles.range.tiles == 3
    moved = tiles.operator
    assert isinstance(moved, vam.Wobbled) and float(moved.wobble.across) == 0.05
    blurred: Any = moved.operator
    assert isinstance(blurred, vam.Defocused) and blurred.defocus == vam.Defocus(0.6, 20.0, -1.0)
    assert blurred.tolerance == 0.05


METHODS_ASKED = {
    'kind = "osmo"\noutside = 0.5\ngain = 0.25\n': vam.OSMO(outside=0.5, gain=0.25),
    'kind = "bclp"\np = 3.0\nslack = [0.1, 0.02]\n[method.response]\nkind = "generalized"\nsteepness = 5.0\n': vam.BCLP(
        p=3.0, slack=(0.1, 0.02), response=GeneralizedLogistic(steepness=5.0)
    ),
    'kind = "lbfgs"\nefficiency = 0.01\nhistory = 3\n': vam.LBFGS(efficiency=0.01, history=3),
    'kind = "cal"\nmomentum = 0.5\n': vam.GradientDescent(momentum=0.5),
    'kind = "penalty"\npenalty = [2.0, 1.0]\n': vam.PenaltyMinimization(penalty=(2.0, 1.0)),
    'kind = "lbfgs"\nefficiency = 0.2\n': vam.LBFGS(efficiency=0.2),
    'kind = "fbp"\n': vam.FilteredBackProjection(),
    'kind = "recipe"\nbackground = 0.5\n[method.diffusion]\ndiffusivity = "1e-4 mm2/s"\nseconds = "1 s"\n': vam.Recipe(
        background=0.5, diffusion=Diffusion(1e-4, 1.0)
    ),
}


@pytest.mark.parametrize("text", METHODS_ASKED)
def test_every_method_with_its_parameters(text: str) -> None:
    assert Job.parse(f"{HEAD}[method]\n{text}").file.method == METHODS_ASKED[text]


@pytest.mark.parametrize(("keys", "kinds", "own"), [
    ("background = 0.8", 'kind = "recipe"', 'this table without a kind is "ramp"'),
    ("p = 2.0", 'kind = "bclp"', 'this table without a kind is "ramp"'),
    ('kind = "osmo"\nefficiency = 0.1', 'kind = "lbfgs"', 'this table is "osmo"'),
])  # fmt: skip
def test_a_key_of_another_method_is_refused_with_its_name(keys: str, kinds: str, own: str) -> None:
    with pytest.raises(JobError, match=rf"method\.\w+: unknown key; it is one of {kinds}, and {own}; set the kind"):
        Job.parse(f"{HEAD}[method]\n{keys}\n")
    with pytest.raises(JobError, match="method.sigma_of_nothing: unknown key; expected one of outside, inside"):
        Job.parse(f"{HEAD}[method]\nsigma_of_nothing = 1\n")
    assert Job.parse(f"{HEAD}[method]\nhistory = 3\n").file.method == vam.SurfaceRamp(history=3)


def test_methods_of_files_are_those_of_python() -> None:
    named = {kind: load(path) for kind, path in FAMILIES["method"].nouns.items()}
    assert {"default": named["ramp"], **named} == METHODS


RUNS = {
    "fan": f'[vessel]\nkind = "fan"\nthrow = "300 mm"\n[vessel.vessel]\n{ROUND}',
    "tiles": "[tiles]\nrows = 12\noverlap = 2\n",
    "inclined": f'[light]\nkind = "inclined"\nelevation = "20 deg"\n[light.vessel]\n{WET}',
    "bclp": '[method]\nkind = "bclp"\np = 3.0\n',
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_they_are_solved_written_and_proven(name: str, tmp_path: Path) -> None:
    job = Job.parse(HEAD + RUNS[name], SMALL)
    solve(job, tmp_path / "x.vam")
    proven = prove(tmp_path / "x.vam")
    assert repr(proven.proof.operator) == repr(built(RUNS[name], name=None)) and proven.proof.scores.in_voxels > 100
    assert proven.plan.method == repr(job.file.method or SurfaceRamp())


RESIN = """
name = "a resin of a test"
[index]
form = "points"
wavelength = ["405 nm"]
index = [1.5]
source = "nobody measured this resin"
[extinction]
wavelength = ["400 nm", "410 nm"]
absorption = ["0.2 1/mm", "0.1 1/mm"]
source = "nobody measured this resin"
[viscosity]
value = "1 Pa s"
source = "nobody measured this resin"
[molar_mass]
value = "300 g/mol"
source = "nobody measured this resin"
[temperature]
value = "293 K"
source = "nobody measured this resin"
[critical_dose]
value = "50 mJ/cm3"
source = "nobody measured this resin"
"""
GLASS = '[vial]\nradius = "12.4 mm"\nwall = "1 mm"\nwall_index = 1.47\n'


def test_a_material_brings_index_absorption_dose_and_diffusion(tmp_path: Path) -> None:
    (tmp_path / "resin.toml").write_text(RESIN, encoding="utf-8")
    text = '[resin]\nmaterial = "resin.toml"\nwavelength = "405 nm"\ninhibitor = "oxygen"\nexposure = "30 s"\n'
    A = built(text + GLASS, tmp_path)
    assert A.outer.vessel.resin_index == 1.5 and A.outer.vessel.absorption == pytest.approx(0.15)
    diffusivity = Resin.load(tmp_path / "resin.toml").diffusivity("oxygen")
    assert A.inner.diffusion == Diffusion(diffusivity, 30.0)
    asked = Job.parse(HEAD + text + GLASS + '[print]\nirradiance = "65 mW/cm2"\n', folder=tmp_path).file
    assert asked.print is not None and asked.print.critical_dose == pytest.approx(0.05)
    said = Job.parse(HEAD + text + GLASS + "resin_index = 1.4\n", folder=tmp_path).file
    assert said.vial.resin_index == 1.4  # type: ignore[union-attr]  # what a file says itself comes first
    inner = GLASS.replace("[vial]", '[vessel.vessel]\nkind = "vial"')
    text += f'[vessel]\nkind = "fan"\nthrow = "300 mm"\n{inner}'
    fan: Any = Job.parse(HEAD + text, folder=tmp_path).file.vessel
    assert fan.vessel.resin_index == 1.5 and fan.throw == 300.0 < inf


def test_a_bundled_resin_is_found_and_what_it_lacks_is_told() -> None:
    text = '[resin]\nmaterial = "dudma-pegda"\nwavelength = "405 nm"\n'
    wanted = Job.parse(HEAD + text + GLASS + 'absorption = "0.05 1/mm"\n').file
    assert wanted.vial.resin_index == Resin.load("dudma-pegda").refraction(405 * nm)  # type: ignore[union-attr]
    for wrong, said in (
        (text + GLASS, r"vial\.absorption: no source gives the absorption .* or write absorption = … into \[vial\]"),
        (text.replace("dudma-", "dudma_") + GLASS, r"line \d+: resin\.material: .*did you mean 'dudma-pegda'"),
        (text.replace("405 nm", "700 um") + GLASS, r"vial\.resin_index: "),
        (text.replace('wavelength = "405 nm"', "") + GLASS, r"resin\.wavelength: got None; expected a wavelength"),
        ('[resin]\ninhibitor = "oxygen"\n' + GLASS, r'resin: expected inhibitor = "oxygen" with material and exposure'),
        (text, r"resin\.material: got 'dudma-pegda', which is not used: there is no vessel .* add \[vial\]"),
        (
            text + GLASS + 'resin_index = 1.5\nabsorption = "0.05 1/mm"\n',
            r"resin\.material: .*\[vial\] has its own index and absorption; .*leave them out there",
        ),
        ("[resin]\nprecompensate = true\n", r"resin\.precompensate: expected diffusion or an inhibitor"),
    ):
        with pytest.raises(JobError, match=said):
            Job.parse(HEAD + wrong)


@pytest.mark.slow
def test_light_found_for_the_dose_after_diffusion_prints_better(tmp_path: Path) -> None:
    """The same part, beam and method; both are judged by the dose after diffusion, through the same operator."""
    diffusion = '[resin.diffusion]\ndiffusivity = "1e-2 mm2/s"\nseconds = "10 s"\n'
    settings = [
        "target.pitch=500 um",
        "beam.pitch=500 um",
        "turntable.angles=60",
        "solve.iterations=30",
        'solve.method="lbfgs"',
    ]
    for name, text in (("ignored", ""), ("inside", diffusion)):
        solve(Job.parse(f"{HEAD}{text}", settings), tmp_path / f"{name}.vam")
    inside = prove(tmp_path / "inside.vam").proof
    ignored = vam.simulate(
        inside.operator, load_frames(tmp_path / "ignored.vam", inside.operator.device), inside.target
    )
    assert isinstance(inside.operator, Composed)
    assert 1.0 - inside.scores.iou < 0.25 * (1.0 - ignored.scores.iou)
    assert inside.scores.window > ignored.scores.window


def test_precompensation_starts_the_recipe_and_the_proof_has_diffusion(tmp_path: Path) -> None:
    text = '[resin]\nprecompensate = true\n[resin.diffusion]\ndiffusivity = "1e-2 mm2/s"\nseconds = "20 s"\n'
    solve(Job.parse(f'{HEAD}{text}[method]\nkind = "recipe"\n', SMALL), tmp_path / "x.vam")
    proven = prove(tmp_path / "x.vam")
    assert isinstance(proven.proof.operator, Composed) and "diffusion=Diffusion(diffusivity=0.01" in proven.plan.method
    A: Any = proven.proof.operator.outer
    target = vam.Target(A.grid, "boat", proven.proof.target, 5.0, 1.0, 11.5)
    method = vam.Recipe(diffusion=Diffusion(1e-2, 20.0))  # the operator's own diffusion does not count beside it
    plan = vam.optimize(A, target, method=method, iterations=2)
    assert [step["loss"] for step in proven.plan.history] == pytest.approx([step.loss for step in plan.history])
    with pytest.raises(JobError, match=r'resin\.precompensate: expected \[method\] kind = "recipe"'):
        Job.parse(HEAD + text)


@pytest.mark.slow
def test_two_colors_are_found_written_and_proven_together(tmp_path: Path) -> None:
    vial = f'[vial]\n{ROUND.partition(chr(10))[2]}absorption = "0.05 1/mm"\n'
    text = f'{HEAD}{vial}[colors]\nabsorption = "0.1 1/mm"\n[colors.rule]\niterations = 20\n'
    job = Job.parse(text, SMALL)
    assert job.file.colors is not None and job.file.colors.rule == LeastSquares(iterations=20)
    solve(job, tmp_path / "x.vam")
    proven = prove(tmp_path / "x.vam")
    uv = prove(tmp_path / "x-uv.vam").proof
    assert (proven.proof.operator.vessel.absorption, uv.operator.vessel.absorption) == (0.05, 0.1)  # type: ignore[union-attr]
    light = proven.proof.frames.irradiance(uv.operator.device), uv.frames.irradiance(uv.operator.device)
    dose = proven.proof.operator.T(light[0]).numpy() - uv.operator.T(light[1]).numpy()
    assert np.allclose(proven.proof.dose.numpy(), dose, atol=1e-5 * dose.max())
    solve(Job.parse(f'{HEAD}{vial}[solve]\nmethod = "lbfgs"\n', SMALL), tmp_path / "one.vam")
    assert proven.proof.scores.iou > prove(tmp_path / "one.vam").proof.scores.iou
    with pytest.raises(BadInput, match=r"\[colors\] got no vessel"):
        solve(Job.parse(HEAD + '[colors]\nabsorption = "0.1 1/mm"\n', SMALL), tmp_path / "none.vam")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"[vessel]\n{ROUND}[light]\n{ROUND}", r"vessel: got \[vessel\] and \[light\]"),
        ('[solve]\nmethod = "osmo"\n[method]\nkind = "osmo"\n', r"solve\.method: got a method here and \[method\]"),
        ('[wobble]\nradius = "1 mm"\nacross = "1 mm"\n', "wobble: expected radius"),
        ('[light]\nkind = "inclined"\n', r"light\.elevation is missing; add elevation = … to \[light\]"),
        (f"[light]\nkind = 'cone'\nthrow = '9 mm'\n[light.vessel]\n{ROUND}", "light: Cone got Vial.*expected a Vat"),
        ("[method]\nkind = 'osmo'\n[colors]\nabsorption = '1 1/mm'\n", r"method: got \[method\] and \[colors\]"),
    ],
)
def test_what_does_not_go_together_is_named(text: str, said: str) -> None:
    with pytest.raises(JobError, match=said):
        Job.parse(HEAD + text)


ONE_BIT = '[frames]\nbits = 1\ndither = "fit"\n'
VIAL_TABLE = f"[vial]\n{ROUND.partition(chr(10))[2]}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f'{VIAL_TABLE}[defocus]\nfwhm = "1 mm"\ndepth_of_focus = "3 mm"\n{ONE_BIT}', "light of Defocused.*expected"),
        (
            f'{VIAL_TABLE}[resin.diffusion]\ndiffusivity = "1e-2 mm2/s"\nseconds = "9 s"\n{ONE_BIT}',
            "light of .*expected that of a Projection",
        ),
        (f'{VIAL_TABLE}[colors]\nabsorption = "0.1 1/mm"\n{ONE_BIT}', "frames.dither: got 'fit'.*one color"),
    ],
)
def test_frames_that_cannot_be_made_are_refused_before_light_is_sought(
    text: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for work in ("vamgpu.jobs.run.optimize", "vamgpu.jobs.run.superposed"):
        monkeypatch.setattr(work, lambda *_, **__: pytest.fail("light was sought"))
    with pytest.raises(BadInput, match=said):
        solve(Job.parse(HEAD + text, SMALL), tmp_path / "x.vam")


def test_a_web_has_every_option_of_its_roller_and_film() -> None:
    from vamgpu.jobs.demo import WEB_JOB as WEB

    options = 'reflectivity = 0.1\ncompensation = 2.0\ndivergence = "1 deg"\nneutral = 0.4\nrays = 16\nfan = 5\n'
    options += 'planes = ["-9 mm", "-0.5 cm"]\n'
    text = WEB.replace("[film]\n", '[film]\nsubstrate = ["0.1 mm", 1.6]\n')
    text = text.replace("[roller]\n", f"[roller]\n{options}")
    file = WebJob.parse(text).file
    roller = file.roller(film=file.film)
    assert (roller.reflectivity, roller.compensation, roller.neutral, roller.rays, roller.fan) == (0.1, 2.0, 0.4, 16, 5)
    assert roller.planes == pytest.approx((-9.0, -5.0))
    assert roller.divergence == pytest.approx(1 * deg) and roller.film.substrate == (pytest.approx(0.1), 1.6)
    with pytest.raises(JobError, match=r"roller\.substrate: unknown key"):
        WebJob.parse(WEB.replace("[roller]\n", "[roller]\nsubstrate = 3\n"))
