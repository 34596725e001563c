"""CAD models in STEP, of a box that is written here entity by entity."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from needs import missing

from vamgpu.errors import MeshError
from vamgpu.targets.mesh import load_mesh

SIDES = (
    ((0, 4, 6, 2), (-1, 0, 0)), ((1, 3, 7, 5), (1, 0, 0)), ((0, 1, 5, 4), (0, -1, 0)),
    ((2, 6, 7, 3), (0, 1, 0)), ((0, 2, 3, 1), (0, 0, -1)), ((4, 5, 7, 6), (0, 0, 1)),
)  # fmt: skip
HEAD = (
    "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n"
    "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\nENDSEC;\nDATA;\n"
)


class Step:
    """The entities of a file, each with its number."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def __call__(self, text: str) -> str:
        self.lines.append(f"#{len(self.lines) + 1}={text};")
        return f"#{len(self.lines)}"

    def numbers(self, kind: str, values: Sequence[float]) -> str:
        return self(f"{kind}('',({','.join(repr(float(x)) for x in values)}))")

    def placement(self, place: Sequence[float], axis: Sequence[float], across: Sequence[float]) -> str:
        found = self.numbers("CARTESIAN_POINT", place), *(self.numbers("DIRECTION", each) for each in (axis, across))
        return self(f"AXIS2_PLACEMENT_3D('',{','.join(found)})")


def shell(step: Step, size: Sequence[float]) -> str:
    corners = [[size[k] * (n >> k & 1) for k in range(3)] for n in range(8)]
    ends = [step(f"VERTEX_POINT('',{step.numbers('CARTESIAN_POINT', corner)})") for corner in corners]
    edges: dict[tuple[int, int], str] = {}
    faces = []
    for loop, normal in SIDES:
        oriented = []
        for a, b in zip(loop, (*loop[1:], loop[0]), strict=True):
            low, high = sorted((a, b))
            if (low, high) not in edges:
                way = np.subtract(corners[high], corners[low])
                length = float(np.linalg.norm(way))
                vector = step(f"VECTOR('',{step.numbers('DIRECTION', (way / length).tolist())},{length!r})")
                line = step(f"LINE('',{step.numbers('CARTESIAN_POINT', corners[low])},{vector})")
                edges[low, high] = step(f"EDGE_CURVE('',{ends[low]},{ends[high]},{line},.T.)")
            oriented.append(step(f"ORIENTED_EDGE('',*,*,{edges[low, high]},.{'T' if a < b else 'F'}.)"))
        bound = step(f"FACE_OUTER_BOUND('',{step(f'''EDGE_LOOP('',({','.join(oriented)}))''')},.T.)")
        plane = step.placement(corners[loop[0]], normal, (0, 1, 0) if normal[0] else (1, 0, 0))
        faces.append(step(f"ADVANCED_FACE('',({bound}),{step(f'''PLANE('',{plane})''')},.T.)"))
    return step(f"CLOSED_SHELL('',({','.join(faces)}))")


def box(size: Sequence[float], prefix: str) -> bytes:
    """A box from the origin, in millimeters (.MILLI.) or meters ($)."""
    step = Step()
    solid = step(f"MANIFOLD_SOLID_BREP('box',{shell(step, size)})")
    axis = step.placement((0, 0, 0), (0, 0, 1), (1, 0, 0))
    length = step(f"(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({prefix},.METRE.))")
    units = length, step("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    error = step(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),{length},'','')")
    context = step(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({error}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({','.join(units)}))REPRESENTATION_CONTEXT('',''))"
    )
    shape = step(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({axis},{solid}),{context})")
    design = step("APPLICATION_CONTEXT('automotive design')")
    context = step(f"PRODUCT_CONTEXT('',{design},'mechanical')")
    form = step(f"PRODUCT_DEFINITION_FORMATION('','',{step(f'''PRODUCT('box','box','',({context}))''')})")
    context = step(f"PRODUCT_DEFINITION_CONTEXT('part definition',{design},'design')")
    product = step(f"PRODUCT_DEFINITION('design','',{form},{context})")
    definition = step(f"PRODUCT_DEFINITION_SHAPE('','',{product})")
    step(f"SHAPE_DEFINITION_REPRESENTATION({definition},{shape})")
    return (HEAD + "\n".join(step.lines) + "\nENDSEC;\nEND-ISO-10303-21;\n").encode()


@pytest.mark.parametrize(
    ("prefix", "size", "name"), [(".MILLI.", (2, 3, 4), "a.step"), ("$", (0.02, 0.03, 0.01), "a.STP")]
)
def test_a_cad_model_is_read_in_its_unit(prefix: str, size: tuple[float, ...], name: str, tmp_path: Path) -> None:
    if find_spec("cascadio") is None:
        missing('CAD models are read by cascadio: pip install "vamgpu[step]"')
    (tmp_path / name).write_bytes(box(size, prefix))
    solid = load_mesh(tmp_path / name, center=False)
    expected = np.array(size) * (1.0 if prefix == ".MILLI." else 1000.0)
    assert np.allclose(solid.bounds, np.stack([0.0 * expected, expected]), atol=1e-5) and not solid.open_edges
    assert solid.volume == pytest.approx(float(np.prod(expected)), rel=1e-5)
    (tmp_path / "b.step").write_bytes(box(size, prefix)[:3000])
    with pytest.raises(MeshError, match="damaged, or no STEP file with a solid"):
        load_mesh(tmp_path / "b.step")


def test_a_cad_model_without_its_package_names_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vamgpu.targets.mesh.find_spec", lambda _: None)
    (tmp_path / "a.step").write_bytes(HEAD.encode())
    with pytest.raises(MeshError, match=r'pip install "vamgpu\[step\]", or export the part as 3MF or STL'):
        load_mesh(tmp_path / "a.step")
