"""3MF packages as slicers mean them: volumes of boxes, in packages that are written here."""

from __future__ import annotations

import warnings
import zipfile
from itertools import product
from pathlib import Path

import pytest

from vamgpu.errors import EmptyMesh, MeshError
from vamgpu.targets.mesh import load_mesh

SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Corners of a box's faces, wound outward; corners count z first."""
SPACES = (
    'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
    'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" '
    'xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" '
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


def thing(number: int, inside: str, kind: str = "model") -> str:
    return f'<object id="{number}" type="{kind}">{inside}</object>'


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


def chained(levels: int) -> str:
    objects = thing(1, mesh(BLOCK)) + "".join(thing(n, parts(f'objectid="{n - 1}"')) for n in range(2, levels + 2))
    return model(objects, f'objectid="{levels + 1}"')


BEAMS = '<b:beamlattice radius="1"><b:beams><b:beam v1="0" v2="1"/></b:beams></b:beamlattice>'


@pytest.mark.parametrize(
    ("root", "error", "said"),
    [
        (
            model(thing(1, mesh(BLOCK)), 'objectid="1"', head='requiredextensions="q"'),
            MeshError,
            r"org/quilts.*not supported",
        ),
        (model(thing(1, mesh(BLOCK, more=BEAMS)), 'objectid="1"'), MeshError, "beam lattice"),
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
