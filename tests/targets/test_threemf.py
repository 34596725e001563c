"""3MF packages as slicers mean them: volumes of boxes, in packages that are written here."""

from __future__ import annotations

import math
import warnings
import zipfile
from itertools import product
from pathlib import Path

import pytest

from vamgpu.errors import BadInput, EmptyMesh, MeshError, MeshWarning
from vamgpu.scene import Scene
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.role_names import role_in

SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Corners of a box's faces, wound outward; corners count z first."""
SPACES = (
    'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
    'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" '
    'xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" '
    'xmlns:c="http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07" '
    'xmlns:q="http://example.org/quilts"'
)
PRUSA, BAMBU = "Metadata/Slic3r_PE_model.config", "Metadata/model_settings.config"
BLOCK, HOLE = ((0, 0, 0), (10, 10, 5)), ((3, 3, -1), (9, 9, 6))  # 500 mm³, and 180 mm³ of it


def mesh(*boxes: tuple[tuple[float, ...], tuple[float, ...]], more: str = "") -> str:
    corners = [place for box in boxes for place in product(*zip(*box, strict=True))]
    faces = [
        (8 * n + a, 8 * n + b, 8 * n + c) for n in range(len(boxes)) for i, j, k, m in SIDES
        for a, b, c in ((i, j, k), (i, k, m))
    ]  # fmt: skip
    return (
        "<mesh><vertices>" + "".join('<vertex x="{:g}" y="{:g}" z="{:g}"/>'.format(*p) for p in corners)
        + "</vertices><triangles>" + "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*t) for t in faces)
        + f"</triangles>{more}</mesh>"
    )  # fmt: skip


def thing(number: int, inside: str, kind: str = "model", more: str = "") -> str:
    return f'<object id="{number}" type="{kind}" {more}>{inside}</object>'


def model(objects: str, *items: str, head: str = "") -> str:
    build = "".join(f"<item {item}/>" for item in items)
    return f"<model {SPACES} {head}><resources>{objects}</resources><build>{build}</build></model>"


def parts(*components: str) -> str:
    return "<components>" + "".join(f"<component {each}/>" for each in components) + "</components>"


def prusa(number: int, *volumes: tuple[int, int, str]) -> str:
    told = "".join(
        f'<volume firstid="{a}" lastid="{b}"><metadata type="volume" key="volume_type" value="{role}"/></volume>'
        for a, b, role in volumes
    )
    return f'<config><object id="{number}">{told}</object></config>'


def bambu(number: int, **roles: str) -> str:
    told = "".join(f'<part id="{each[1:]}" subtype="{role}"/>' for each, role in roles.items())
    return f'<config><object id="{number}">{told}</object></config>'


def volume(folder: Path, root: str, more: dict[str, str] | None = None) -> float:
    with zipfile.ZipFile(folder / "part.3mf", "w") as package:
        for path, text in {"3D/3dmodel.model": root, **(more or {})}.items():
            package.writestr(path, text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load_mesh(folder / "part.3mf", center=False).volume


BOTH = mesh(BLOCK, HOLE)
ASIDE = "1 0 0 0 1 0 0 0 1 20 0 0"
SUB = {"3D/Objects/a.model": model(thing(1, mesh(BLOCK)) + thing(2, mesh(HOLE)))}
TWO = parts('p:path="/3D/Objects/a.model" objectid="1"', 'p:path="/3D/Objects/a.model" objectid="2"')
CASES = {
    "as it is": (model(thing(1, mesh(BLOCK)), 'objectid="1"'), {}, 500.0),
    "in inches": (model(thing(1, mesh(BLOCK)), 'objectid="1"', head='unit="inch"'), {}, 500.0 * 25.4**3),
    "mirrored, twice as high": (model(thing(1, mesh(BLOCK)), 'objectid="1" transform="-1 0 0 0 1 0 0 0 2 0 0 0"'), {},
                                1000.0),
    "in two places": (model(thing(1, mesh(BLOCK)), 'objectid="1"', f'objectid="1" transform="{ASIDE}"'), {}, 1000.0),
    "moved within a part that is moved": (
        model(thing(1, mesh(BLOCK)) + thing(2, parts('objectid="1"', f'objectid="1" transform="{ASIDE}"')),
              'objectid="2" transform="0 1 0 -1 0 0 0 0 1 0 0 0"'), {}, 1000.0),
    "a negative volume": (model(thing(1, BOTH), 'objectid="1"'),
                          {PRUSA: prusa(1, (0, 11, "ModelPart"), (12, 23, "NegativeVolume"))}, 320.0),
    "a modifier": (model(thing(1, BOTH), 'objectid="1"'),
                   {PRUSA: prusa(1, (0, 11, "ModelPart"), (12, 23, "ParameterModifier"))}, 500.0),
    "two parts of one file": (model(thing(3, TWO), 'objectid="3"'), SUB, 752.0),
    "a negative part of one file": (model(thing(3, TWO), 'objectid="3"'),
                                    {**SUB, BAMBU: bambu(3, _2="negative_part")}, 320.0),
    "a blocker of one file": (model(thing(3, TWO), 'objectid="3"'), {**SUB, BAMBU: bambu(3, _2="support_blocker")},
                              500.0),
    "an item of another file": (model("", 'p:path="/3D/Objects/a.model" objectid="1"'), SUB, 500.0),
    "the same number in two files": (model(thing(1, mesh(HOLE)), 'p:path="/3D/Objects/a.model" objectid="1"'), SUB,
                                     500.0),
    "an item that is not printable": (
        model(thing(1, mesh(BLOCK)) + thing(2, mesh(HOLE)), 'objectid="1"', 'objectid="2" printable="0"'), {}, 500.0),
    "a support": (model(thing(1, mesh(BLOCK)) + thing(2, mesh(HOLE), "support"), 'objectid="1"', 'objectid="2"'), {},
                  500.0),
    "a solid support": (model(thing(2, mesh(BLOCK), "solidsupport"), 'objectid="2"'), {}, 500.0),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("case", CASES)
def test_volumes_are_those_that_slicers_print(case: str, tmp_path: Path) -> None:
    root, more, wanted = CASES[case]
    assert volume(tmp_path, root, more) == pytest.approx(wanted, rel=1e-9)  # of surfaces: what two share counts twice


def test_one_part_of_a_file_is_taken_where_it_lies(tmp_path: Path) -> None:
    volume(
        tmp_path,
        model(thing(1, mesh(BLOCK)) + thing(2, mesh(HOLE)), 'objectid="2"', f'objectid="1" transform="{ASIDE}"'),
    )
    first, second = (load_mesh(tmp_path / "part.3mf", center=False, part=number) for number in (1, 2))
    assert (first.volume, second.volume) == pytest.approx((252.0, 500.0))
    assert second.bounds[0][0] == pytest.approx(20.0 + BLOCK[0][0])
    with pytest.raises(MeshError, match="has 2 parts; expected part 1 to 2, not 3"):
        load_mesh(tmp_path / "part.3mf", part=3)


def chained(levels: int) -> str:
    objects = thing(1, mesh(BLOCK)) + "".join(thing(n, parts(f'objectid="{n - 1}"')) for n in range(2, levels + 2))
    return model(objects, f'objectid="{levels + 1}"')


def lattice(*beams: str, more: str = 'cap="butt"', balls: str = "") -> str:
    """Beams of radius 1 between points of a cross whose arms are 10 long."""
    points = ((-5, 0, 0), (5, 0, 0), (0, -5, 0), (0, 5, 0), (0, 0, 0))
    corners = "".join('<vertex x="{}" y="{}" z="{}"/>'.format(*point) for point in points)
    rods = "".join(f"<b:beam {beam}/>" for beam in beams)
    return (
        f'<mesh><vertices>{corners}</vertices><triangles/><b:beamlattice radius="1" minlength="0.01" {more}>'
        f"<b:beams>{rods}</b:beams>{balls}</b:beamlattice></mesh>"
    )


ROUND = math.pi * 10.0  # a beam of 10 mm without ends
BALL = 4.0 / 3.0 * math.pi
LATTICES = {
    "flat ends": (lattice('v1="0" v2="1"'), ROUND),
    "balls at its ends, by default": (lattice('v1="0" v2="1"', more=""), ROUND + BALL),
    "half balls": (lattice('v1="0" v2="1" cap1="hemisphere"'), ROUND + 0.5 * BALL),
    "a cone": (lattice('v1="0" v2="1" r1="1" r2="0.5"'), math.pi * 10.0 * (1.0 + 0.5 + 0.25) / 3.0),
    "a cone whose wide end bulges": (  # the inner half of the ball reaches beyond the cone; the half ball does not
        lattice('v1="0" v2="1" r1="1" r2="0.5" cap1="hemisphere"'), math.pi * 10.0 * 1.75 / 3.0 + 0.5 * BALL),
    "two that cross": (lattice('v1="0" v2="1"', 'v1="2" v2="3"'), 2.0 * ROUND - 16.0 / 3.0),  # Steinmetz
    "too short ones are ignored": (lattice('v1="0" v2="1"', 'v1="4" v2="4"'), ROUND),
    "one as long as the shortest": (
        lattice('v1="0" v2="1"', 'v1="0" v2="4"', more='minlength="10" cap="butt"').replace('minlength="0.01" ', ""),
        ROUND),
    "one ball": (lattice('v1="0" v2="4"', 'v1="4" v2="1"', more='cap="butt" c:ballmode="mixed" c:ballradius="2"',
                         balls='<c:balls><c:ball vindex="4"/></c:balls>'),
                 8.0 * BALL + ROUND - BALL * (8.0 - 3.0**1.5)),  # less what both fill
}  # fmt: skip


@pytest.mark.parametrize("case", LATTICES)
def test_beams_have_the_volume_of_their_formula(case: str, tmp_path: Path) -> None:
    text, wanted = LATTICES[case]
    root = model(thing(1, text), 'objectid="1"', head='requiredextensions="b c"')
    assert volume(tmp_path, root) == pytest.approx(wanted, rel=0.006)  # flat facets


def test_beams_and_triangles_of_an_object_are_one_body_in_the_units_of_the_file(tmp_path: Path) -> None:
    both = mesh(((-2, -2, -2), (2, 2, 2))).replace(
        "</vertices>", '<vertex x="-5" y="0" z="0"/><vertex x="5" y="0" z="0"/></vertices>'
    )
    beam = '<b:beamlattice radius="1" minlength="0.1" cap="butt"><b:beams><b:beam v1="8" v2="9"/></b:beams>'
    both = both.replace("</mesh>", f"{beam}</b:beamlattice></mesh>")
    root = model(thing(1, both), 'objectid="1" transform="2 0 0 0 2 0 0 0 2 0 0 0"', head='unit="centimeter"')
    assert volume(tmp_path, root) == pytest.approx(8000.0 * (64.0 + 6.0 * math.pi), rel=0.002)


@pytest.mark.parametrize(
    ("root", "error", "said"),
    [
        (
            model(thing(1, mesh(BLOCK)), 'objectid="1"', head='requiredextensions="q"'),
            MeshError,
            r"org/quilts.*not supported",
        ),
        (
            model(thing(1, lattice('v1="0" v2="1"', more='clippingmode="inside"')), 'objectid="1"'),
            MeshError,
            "clipping mode 'inside'.*turn the lattice into triangles",
        ),
        (
            model(thing(1, lattice('v1="0" v2="1"', more='c:ballmode="some"')), 'objectid="1"'),
            MeshError,
            "ball mode 'some'.*expected 'none' or 'mixed' or 'all'",
        ),
        (
            model(thing(1, lattice('v1="0" v2="1"', more='c:ballmode="all"')), 'objectid="1"'),
            MeshError,
            "ball without r, and its lattice has no ballradius",
        ),
        (model(thing(1, lattice('v1="0" v2="9"')), 'objectid="1"'), MeshError, "corners that do not exist"),
        (model(thing(1, lattice('v1="0" v2="1" r1="-1"')), 'objectid="1"'), MeshError, "radius -1"),
        (model(thing(1, lattice('v1="0" v2="1" cap1="cone"')), 'objectid="1"'), MeshError, "end 'cone'.*hemisphere"),
        (model(thing(1, mesh(BLOCK)), 'objectid="7"'), MeshError, "object '7'.*does not exist"),
        (model(thing(1, mesh(BLOCK)), 'objectid="1" printable="0"'), EmptyMesh, "no triangles that are printed"),
        (model(thing(1, mesh(BLOCK)), 'objectid="1"', head='unit="furlong"'), MeshError, "furlong.*micron"),
        (model(thing(1, mesh(BLOCK)), 'objectid="1" transform="1 0"'), MeshError, "damaged"),
        (model(thing(1, mesh(BLOCK)).replace('v1="0"', 'v1="99"')), MeshError, "vertices that do not exist"),
        (chained(40), MeshError, "levels of components"),
        (model(thing(1, parts('objectid="1"')), 'objectid="1"'), MeshError, "levels of components"),
    ],
)
def test_what_cannot_be_read_is_named(root: str, error: type[MeshError], said: str, tmp_path: Path) -> None:
    with pytest.raises(error, match=said):
        volume(tmp_path, root)


def test_negative_volumes_that_leave_nothing_are_told(tmp_path: Path) -> None:
    around = ((-1, -1, -1), (11, 11, 6))
    root = model(thing(1, mesh(BLOCK, around)), 'objectid="1"')
    with pytest.raises(MeshError, match="leave nothing"):
        volume(tmp_path, root, {PRUSA: prusa(1, (0, 11, "ModelPart"), (12, 23, "NegativeVolume"))})


PIN = ((20, 0, 0), (22, 2, 5))
TAGGED = {
    "names of objects": (
        model(thing(1, mesh(BLOCK), more='name="grip"') + thing(2, mesh(PIN), more='name="Insert_Rod.001"'),
              'objectid="1"', 'objectid="2"'), {}),
    "a name around an unnamed part": (
        model(thing(1, mesh(BLOCK)) + thing(2, mesh(PIN), more='name="Part 1"')
              + thing(3, parts('objectid="2"'), more='name="[insert] rods"'), 'objectid="1"', 'objectid="3"'), {}),
    "metadata": (
        model(thing(1, mesh(BLOCK))
              + thing(2, '<metadatagroup><metadata name="v:role">insert</metadata></metadatagroup>' + mesh(PIN)),
              'objectid="1"', 'objectid="2"', head='xmlns:v="http://example.org/roles"'), {}),
    "volumes of PrusaSlicer": (
        model(thing(1, mesh(BLOCK, PIN)), 'objectid="1"'),
        {PRUSA: prusa(1, (0, 11, "ModelPart"), (12, 23, "ModelPart")).replace(
            '<volume firstid="12" lastid="23">',
            '<volume firstid="12" lastid="23"><metadata type="volume" key="name" value="insert.stl"/>')}),
    "parts of Bambu Studio": (
        model(thing(3, parts('objectid="1"', 'objectid="2"')) + thing(1, mesh(BLOCK)) + thing(2, mesh(PIN)),
              'objectid="3"'),
        {BAMBU: '<config><object id="3"><part id="2" subtype="normal_part"><metadata key="name" value="INSERT"/></part>'
                "</object></config>"}),
}  # fmt: skip


@pytest.mark.parametrize("case", TAGGED)
def test_names_are_roles_if_that_is_asked_for_and_else_a_warning(case: str, tmp_path: Path) -> None:
    file, (root, more) = tmp_path / "part.3mf", TAGGED[case]
    with pytest.raises(MeshWarning, match="(?i)objects named '[^']*insert.*roles = \"names\"") as told:
        volume(tmp_path, root, more)
    assert "from_3mf" in str(told.value)
    scene = Scene.from_3mf(file, roles="names", factor=0.5)
    assert [(body.role, body.source.volume) for body in scene.bodies] == [
        ("print", pytest.approx(500.0)),
        ("insert", pytest.approx(20.0)),
    ]
    assert scene.inserts[0].source.bounds[0][0] == 20.0 and scene.factor == 0.5
    assert load_mesh(file, center=False, part=2).volume == pytest.approx(20.0)  # the choice of a part is no doubt


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("insert", "insert"), ("[insert] rod", "insert"), ("Occlusion-2", "insert"), ("zero_dose", "keep out"),
        ("zero-dose pore", "keep out"), ("ZeroDose.003", "keep out"), ("NODOSE", "keep out"), ("keep out", "keep out"),
        ("don\u2019t care", "don't care"), ("dont_care_1", "don't care"), ("model", "print"), ("[print] gear", "print"),
        ("gear", None), ("inserted", None), ("rod insert", None), ("dose", None), ("7", None), ("", None),
    ],
)  # fmt: skip
def test_how_a_name_begins_is_its_role(name: str, role: str | None) -> None:
    assert role_in([name]) == role


def test_an_inner_name_comes_first_and_what_resembles_a_role_is_warned_of(tmp_path: Path) -> None:
    assert role_in(["print core", "insert assembly"]) == "print" and role_in(["core", "insert rods"]) == "insert"
    named = [thing(1, mesh(BLOCK), more='name="insert"'), thing(2, mesh(PIN), more='name="rod insert"')]
    named += [thing(3, mesh(HOLE), more='name="gear"')]
    with pytest.raises(MeshWarning):  # of its insert
        volume(tmp_path, model("".join(named), *(f'objectid="{n}"' for n in (1, 2, 3))))
    with pytest.warns(MeshWarning, match="part.3mf has objects named 'rod insert', which print"):
        scene = Scene.from_3mf(tmp_path / "part.3mf", roles="names")
    assert [body.role for body in scene.bodies] == ["insert", "print", "print"]
    with pytest.raises(BadInput, match='roles is None; .*give roles="names"'):
        Scene.from_3mf(tmp_path / "part.3mf")


def test_what_is_kept_out_needs_a_limit(tmp_path: Path) -> None:
    file = tmp_path / "part.3mf"
    named = [thing(1, mesh(BLOCK), more='name="zero-dose"'), thing(2, mesh(PIN), more='name="rod"')]
    root = model("".join(named), 'objectid="1"', 'objectid="2"')
    with pytest.raises(MeshWarning, match="zero-dose"):
        volume(tmp_path, root)
    kept = Scene.from_3mf(file, roles="names", dose=0.6)
    assert [(body.name, body.role, body.dose) for body in kept.bodies] == [("zero-dose", "keep out", 0.6),
                                                                           ("rod", "print", None)]  # fmt: skip
    with pytest.raises(BadInput, match="'zero-dose' of 'part.3mf' is to be kept out without a limit"):
        Scene.from_3mf(file, roles="names")
    with pytest.raises(BadInput, match="roles is 'name'; expected 'names'"):
        Scene.from_3mf(file, roles="name")  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="a mesh file ending in .3mf"):
        Scene.from_3mf(tmp_path / "part.stl", roles="names")
    volume(tmp_path, model(thing(1, mesh(BLOCK), more='name="gear"'), 'objectid="1"'))
    with pytest.raises(BadInput, match="no object of 'part.3mf' has a role in its name: 'gear'"):
        Scene.from_3mf(file, roles="names")


def test_a_negative_volume_cuts_every_part_and_leaves_their_numbers(tmp_path: Path) -> None:
    root = model(thing(1, mesh(BLOCK, HOLE, PIN)), 'objectid="1"')
    told = {PRUSA: prusa(1, (0, 11, "ModelPart"), (12, 23, "NegativeVolume"), (24, 35, "ModelPart"))}
    assert volume(tmp_path, root, told) == pytest.approx(340.0)
    first, second = (load_mesh(tmp_path / "part.3mf", center=False, part=number) for number in (1, 2))
    assert (first.volume, second.volume) == pytest.approx((320.0, 20.0))
