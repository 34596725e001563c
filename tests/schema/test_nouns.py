"""Nouns written, read back and refused; what constructors check is what files are told."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.chemistry.diffusion import Diffusion, Spread
from vamgpu.errors import BadInput, StorageError
from vamgpu.methods.plan_folder import describe, entries_of, projection_from
from vamgpu.operators.compose import Composed, Sum
from vamgpu.optics.index_field import FunctionField, GridField, Region, parabolic
from vamgpu.schema import check, fields_of, write
from vamgpu.schema.noun import MISSING
from vamgpu.schema.read import read
from vamgpu.schema.registry import FAMILIES, find
from vamgpu.storage.folder import Folder, write_folder
from vamgpu.targets import shapes
from vamgpu.units import deg

GRID, MOTION = vam.Grid((12, 12, 8), 0.2), vam.Turntable(6)
BEAM = vam.Beam((24, 8), 0.2)
VIAL = vam.Vial(radius=5.0, wall=0.5, resin_index=1.5, wall_index=1.47, bath_index=1.33, absorption=0.05)
DOUBLE = vam.DoubleWalledVial(
    radius=5.0, wall=0.5, gap=0.6, inner_wall=0.3, liquid_index=1.36, wall_index=1.47, resin_index=1.5, bath_index=1.33,
    absorption=0.05,
)  # fmt: skip
GRADED = vam.GradedVial(5.0, 0.5, parabolic(1.5, 0.01), 1.47, rays=65, rows=33)
VAT = vam.Vat(width=12.0, radius=5.0, absorption=0.1)


def projection(vessel: Any, motion: vam.Turntable = MOTION) -> vam.Projection:
    return vam.Projection(GRID, BEAM, motion, vessel)


def oblique(light: Any, wobble: vam.Wobble | None = None) -> vam.Oblique:
    return vam.Oblique(GRID, BEAM, MOTION, light, wobble)


def spread() -> Composed:
    A = projection(VIAL)
    return Composed(A, Spread(A.grid, Diffusion(1e-4, 20.0), A.device))


OPERATORS = {
    "air": lambda: projection(None),
    "vial": lambda: projection(VIAL),
    "vat": lambda: projection(vam.Vat(width=12.0, absorption=0.05)),
    "measured angles": lambda: projection(VIAL, vam.Turntable([0.0, 1.0, 2.5], dwell=[1.0, 2.0, 3.0])),
    "misaligned": lambda: projection(vam.Misaligned(VIAL, offset=0.3, tilt=-2 * deg)),
    "fan": lambda: projection(vam.Fan(VIAL, throw=300.0)),
    "parallel fan": lambda: projection(vam.Fan(None)),
    "occluded fan": lambda: projection(vam.Occluded(vam.Fan(VIAL, throw=300.0), 1.0, 1.0, 0.3, 0.25)),
    "graded": lambda: projection(GRADED),
    "double walled": lambda: projection(DOUBLE),
    "square": lambda: projection(vam.SquareBath(DOUBLE, 11.0, 0.4, 1.52, tilt=-3 * deg, liquid_absorption=0.01)),
    "cone": lambda: oblique(vam.Cone(VAT, throw=200.0, offset=0.1)),
    "inclined": lambda: oblique(vam.Inclined(VAT, elevation=0.2, offset=0.1), vam.Wobble.circle(0.05, 0.3, MOTION)),
    "inclined air": lambda: oblique(vam.Inclined(elevation=0.2)),
    "rays": lambda: oblique(VIAL, vam.Wobble(0.1, 0.2)),
    "defocused": lambda: vam.Defocused(projection(VIAL), vam.Defocus(0.3, 4.0, 0.5), 0.05),
    "defocused cone": lambda: vam.Defocused(oblique(vam.Cone(VAT, throw=200.0)), vam.Defocus(0.3, 4.0)),
    "defocused graded": lambda: vam.Defocused(oblique(GRADED), vam.Defocus(0.3, 4.0)),
    "wobbled": lambda: vam.Wobbled(projection(VIAL), vam.Wobble([0.1, 0.0, 0.0, -0.1, 0.0, 0.05])),
    "tiles": lambda: vam.Tiles(vam.Wobbled(projection(None), vam.Wobble(0.1)), 5, centers=[-0.3, 0.35]),
    "diffusion": spread,
    "sum": lambda: Sum([projection(VIAL), projection(vam.Misaligned(VIAL, offset=0.1))], [0.75, 0.25]),
}


@pytest.mark.parametrize("name", OPERATORS)
def test_an_operator_comes_back_from_a_manifest(name: str) -> None:
    A = OPERATORS[name]()
    B = projection_from(json.loads(json.dumps(describe(A), allow_nan=False)), A.device)
    y = np.random.default_rng(0).random(A.range.shape)
    assert type(B) is type(A) and B.range == A.range
    assert np.array_equal(B.T(y), A.T(y)) and np.abs(A.T(y)).max() > 0
    assert describe(B) == describe(A)


@pytest.mark.parametrize("name", ["occluded fan", "square", "inclined", "tiles", "diffusion"])
def test_an_operator_comes_back_from_text_with_units(name: str) -> None:
    A = OPERATORS[name]()
    table = write(A, units=True)
    y = np.random.default_rng(0).random(A.range.shape)
    assert np.allclose(read("operator", table, device=A.device).T(y), A.T(y), rtol=1e-12, atol=0.0)


class Own(vam.Vial):
    """Known to nobody."""


OWN = Own(radius=5.0, wall=0.5, resin_index=1.5, wall_index=1.47)
SAMPLED = GridField.from_array(np.full((60, 60), 1.5), 0.2)
FUNCTION = FunctionField(lambda x, y: 1.5 + 0.0 * x, Region.box((-5.0, -5.0), (5.0, 5.0)))
UNWRITTEN = {
    "a curved focus": vam.Defocus(0.3, 4.0, lambda u: 0.01 * u**2),
    "an index on a grid, kept nowhere": vam.GradedVial(5.0, 0.5, SAMPLED, 1.47),
    "an index of a function": vam.GradedVial(5.0, 0.5, FUNCTION, 1.47),
    "a class of one's own": OWN,
    "one inside a rod's shadow": vam.Occluded(OWN),
    "weights of voxels": vam.BCLP(weight=np.ones((2, 2, 2))),
    "numbers that are none": vam.Wobble(0.1),
}
object.__setattr__(UNWRITTEN["numbers that are none"], "across", float("nan"))


@pytest.mark.parametrize("name", UNWRITTEN)
def test_what_only_python_knows_is_refused(name: str) -> None:
    with pytest.raises(BadInput, match="nothing describes|which no file can hold|only finite numbers"):
        write(UNWRITTEN[name])


def test_a_manifest_is_refused_for_an_operator_that_no_noun_describes() -> None:
    with pytest.raises(BadInput, match="is not a registered component"):
        describe(projection(OWN), {})


CURED = 1.45 + 0.05 * np.random.default_rng(1).random(GRID.shape)
ONE_RAY = vam.Beam((24, 8), 0.2, spread=0.0)
WITH_ARRAYS = {
    "an index on a grid": lambda device: vam.Projection(
        GRID, BEAM, MOTION, vam.Fan(vam.GradedVial(5.0, 0.5, SAMPLED, 1.47, rays=65, rows=33), throw=90.0), device
    ),
    "what the resin carries": lambda device: vam.TracedProjection(
        GRID,
        ONE_RAY,
        MOTION,
        vam.CoRotatingMedium(CURED[:, :, 0], 0.05, CURED[:, :, 1] > 1.497, 1.46),
        device=device,
        step=0.4,
    ),
    "all in three dimensions": lambda device: vam.TracedProjection(
        GRID, ONE_RAY, MOTION, vam.CoRotatingMedium(CURED, CURED - 1.4), vam.RayBundle.cone(ONE_RAY, 0.02, 3), device
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_ARRAYS)
def test_arrays_of_an_operator_are_kept_beside_the_manifest(name: str, device: Device, tmp_path: Path) -> None:
    """Every entry of the operator comes back; an array that was changed is found by its hash."""
    A: Any = WITH_ARRAYS[name](device)
    arrays: dict[str, Any] = {}
    geometry = describe(A, arrays)
    folder = write_folder(tmp_path / "job", entries_of(arrays), inputs={"geometry": geometry}, details={}, device="")
    assert set(folder.manifest.arrays) == set(arrays) != set()
    B = projection_from(folder.manifest.inputs["geometry"], device, folder.array)
    x, y = (np.random.default_rng(k).random(space.shape) for k, space in enumerate((A.domain, A.range)))
    assert np.array_equal(B(x), A(x)) and np.abs(A(x)).max() > 0
    assert np.allclose(B.T(y), A.T(y), rtol=1e-5)  # rays add to voxels in any order on some devices
    again: dict[str, Any] = {}
    assert describe(B, again) == geometry and all(np.array_equal(arrays[k], again[k]) for k in again)
    with pytest.raises(StorageError, match="expected the arrays of its job folder"):
        projection_from(geometry, device)
    file = tmp_path / "job" / "manifest.json"
    text, changed = file.read_text(), folder.manifest.arrays[next(iter(arrays))].sha256
    file.write_text(text.replace(changed, "0" * 64))
    with pytest.raises(StorageError, match="changed or damaged"):
        projection_from(geometry, device, Folder.open(tmp_path / "job").array)


def test_a_job_file_writes_no_arrays() -> None:
    table = {"kind": "grid", "coefficients": [[1.0]], "corner": ["0 mm"] * 3, "pitch": "1 mm", "region": {}}
    with pytest.raises(BadInput, match=r"coefficients: got .*; expected an array, which is made in Python"):
        read("index", table)


def test_garbled_geometry_is_named() -> None:
    table = describe(projection(vam.Fan(VIAL, throw=300.0)))
    table["vessel"]["vessel"]["radius"] = "5"
    table["vessel"]["trow"] = 3.0
    with pytest.raises(StorageError, match=r"(?s)vessel\.vessel\.radius: got '5'.*vessel\.trow: unknown key"):
        projection_from(table, projection(None).device)


def test_defaults_are_what_constructors_have() -> None:
    """A table of the required fields alone gives the noun that Python makes of them."""
    assert read("method", {}) == vam.SurfaceRamp() and read("method", {"kind": "osmo"}) == vam.OSMO()
    vial = {"kind": "vial", "radius": "12.4 mm", "wall": "1 mm", "resin_index": 1.5, "wall_index": 1.4}
    assert read("vessel", vial) == vam.Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.4)
    assert read("lens", {"powers": ["5 dpt", "8 dpt"]}) == vam.TunableLens(powers=(5.0, 8.0))


@pytest.mark.parametrize(
    ("family", "table", "said"),
    [
        ("vessel", {"kind": "fann"}, "no vessel 'fann'; expected one of .*did you mean 'fan'"),
        ("vessel", {"kind": "round"}, r"no vessel 'round'; expected one of .*: did you mean 'vial' \("),
        ("vessel", {"throw": "3 mm"}, "kind is missing; add kind = one of vial"),
        ("vessel", {"kind": "fan", "throw": "-3 mm"}, r"vessel\.throw: got '-3 mm'; expected a length > 0"),
        ("vessel", {"kind": "vat", "width": "3 mm", "radius": "2 mm"}, "expected at most 1.5 mm"),
        ("wrap", {"step": "200 deg"}, r"(?s)radius is missing.*got '200 deg'; is 3.49066 rad; expected > 0, ≤ 3.14"),
        ("wobble", {"across": ["1 mm", 2]}, r"wobble\.across, value 2: got 2; expected a length with its unit"),
        ("method", {"kind": "bclp", "response": {"kind": "logistic", "steepness": "a"}}, "response.steepness: got 'a'"),
    ],
)
def test_wrong_tables_are_named(family: str, table: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        read(family, table)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: vam.Vial(-1.0, 0.5, 1.5, 1.4), r"Vial radius \[mm\] is -1.0; expected a finite number > 0"),
        (lambda: vam.Vial(5.0, 0.5, 0.9, 1.4), "Vial resin_index is 0.9; expected a refractive index"),
        (lambda: vam.Fan(None, throw=float("nan")), r"Fan throw \[mm\] is nan"),
        (
            lambda: vam.Misaligned(None, offset=float("inf")),
            r"Misaligned offset \[mm\] is inf; expected a finite number",
        ),
        (lambda: vam.Occluded(transmittance=1.5), r"Occluded transmittance is 1.5; expected a share in 0\.\.1"),
        (lambda: vam.Beam((4, 4), 0.1, 1.5), "Beam fill is 1.5; expected a share of the pixel's area"),
        (lambda: vam.TunableLens(bins=2.5), "TunableLens bins is 2.5; expected a whole number"),  # type: ignore[arg-type]
        (lambda: vam.Defocus(0.1, 4.0, "a"), r"Defocus focus: got 'a'; expected a length"),  # type: ignore[arg-type]
    ],
)
def test_constructors_check_by_the_same_bounds(make: Any, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        make()


def test_checking_keeps_floats() -> None:
    vial = vam.Vial(radius=np.float32(5), wall=1, resin_index=2, wall_index=1)  # type: ignore[arg-type]
    assert [type(value) for value in (vial.radius, vial.wall, vial.resin_index)] == [float] * 3
    check(vial)


NOUNS = [(family, kind) for family, members in FAMILIES.items() for kind in members.nouns]


@pytest.mark.parametrize(("family", "kind"), NOUNS)
def test_every_noun_says_what_its_fields_mean(family: str, kind: str) -> None:
    cls = find(family, kind)
    silent = [field.name for field in fields_of(cls) if not field.doc]
    assert cls.__module__.startswith(("vamgpu.methods", "vamgpu.losses")) or not silent
    assert (cls.__doc__ or "").strip()
    assert all(field.default is MISSING or not field.required for field in fields_of(cls))


untyped: Any = vam
"""Type checkers know numbers alone."""
AS_TEXT: dict[str, tuple[Any, Any]] = {
    "vial": (
        lambda: untyped.Vial("12.4 mm", "1000 um", 1.5, 1.47, absorption="0.5 /cm"),
        untyped.Vial(12.4, 1.0, 1.5, 1.47, absorption=0.05),
    ),
    "beam": (lambda: untyped.Beam((24, 8), "67 um", spread="25 µm"), untyped.Beam((24, 8), 0.067, spread=0.025)),
    "grid": (lambda: untyped.Grid((4, 4, 4), "0.1 mm"), untyped.Grid((4, 4, 4), 0.1)),
    "web": (lambda: untyped.WebGrid((4, 4, 4), ("50 um", 0.1, "0.2 mm")), untyped.WebGrid((4, 4, 4), (0.05, 0.1, 0.2))),
}


@pytest.mark.parametrize("name", AS_TEXT)
def test_a_constructor_takes_text_with_units(name: str) -> None:
    make, expected = AS_TEXT[name]
    assert make() == expected


def test_targets_and_scenes_take_text_with_units() -> None:
    mesh, mask = shapes.build("boat"), np.pad(np.ones((4, 4, 4)), 2)
    at = untyped.Target.from_mesh(mesh, height=2.0, pitch=0.2, device="numpy")
    text = untyped.Target.from_mesh(mesh, height="2 mm", pitch="200 um", device="numpy")
    assert at.grid == text.grid and at.height == text.height
    assert untyped.Target.from_array(mask, "250 um").grid == untyped.Target.from_array(mask, 0.25).grid
    body = untyped.Body(mask, pitch="250 um")
    assert body.pitch == 0.25 and untyped.Scene(body).grid("250 um") == untyped.Scene(body).grid(0.25)
    clear = untyped.Body(mask, "insert", index=1.5, absorption="0.2 /mm", pitch=0.25)
    assert clear.absorption == 0.2


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: untyped.Vial("12.4", 1.0, 1.5, 1.47),
            "Vial radius: got '12.4'; expected a length in mm",
        ),
        (
            lambda: untyped.Vial("12 m", 1.0, 1.5, 1.47),
            "Vial radius: got '12 m'; is 12000 mm; expected 0.05 to 1000 mm",
        ),
        (lambda: untyped.Vial(12.4, 1.0, "1.5", 1.47), "Vial resin_index is '1.5'"),
        (lambda: untyped.Beam((1, 1), "67 mW/cm2"), "Beam pitch: got '67 mW/cm2'; expected a length in"),
        (lambda: untyped.Target.from_array(np.ones((2, 2, 2)), "one"), "Grid pitch: got 'one'; expected a length"),
        (
            lambda: untyped.Target.from_mesh("a.stl", height="-2 mm", pitch=0.1),
            "height: got '-2 mm'; expected a length >",
        ),
        (
            lambda: untyped.Target.from_mesh("a.stl", height=2.0, pitch="2 s"),
            "pitch: got '2 s'; expected a length",
        ),
    ],
)
def test_wrong_text_is_named(make: Any, said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)):
        make()
