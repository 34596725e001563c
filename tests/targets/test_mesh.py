"""Meshes: reading, repair, placement, and the errors for what cannot be used."""

from __future__ import annotations

import struct
import warnings
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from vamgpu.errors import BadInput, EmptyMesh, MeshError, MeshWarning, NotWatertight
from vamgpu.targets.circle import smallest_enclosing_circle
from vamgpu.targets.mesh import FORMATS, Mesh, from_trimesh, load_mesh
from vamgpu.targets.repair import repaired
from vamgpu.targets.solid import Solid
from vamgpu.targets.target import Target

QUARTER_TURN_ABOUT_X = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def block(size: tuple[float, float, float] = (2.0, 3.0, 4.0)) -> Solid:
    mesh = trimesh.creation.box(size)
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "block")


def ball(subdivisions: int = 3, radius: float = 2.0) -> Solid:
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "ball")


def soup(solid: Solid) -> Solid:
    """Every triangle with three vertices of its own."""
    return Solid(
        solid.vertices[solid.faces].reshape(-1, 3),
        np.arange(3 * len(solid.faces), dtype=np.int32).reshape(-1, 3),
        solid.name,
    )


def joined(first: Solid, second: Solid) -> Solid:
    faces = np.concatenate([first.faces, second.faces + len(first.vertices)])
    return Solid(np.concatenate([first.vertices, second.vertices]), faces)


@pytest.mark.parametrize("suffix", FORMATS[:4])
def test_every_format_gives_the_same_part_back(tmp_path: Path, suffix: str) -> None:
    file = block().save(tmp_path / f"part{suffix}")
    part = load_mesh(file)
    assert part.name == "part"
    assert part.open_edges == 0
    assert part.volume == pytest.approx(24.0, rel=1e-6)
    np.testing.assert_allclose(part.bounds, [[-1.0, -1.5, -2.0], [1.0, 1.5, 2.0]], atol=1e-6)
    assert [item.name for item in tmp_path.iterdir()] == [file.name]


def test_units_of_the_mesh_are_converted() -> None:
    mesh = trimesh.creation.box((1.0, 1.0, 1.0))
    mesh.units = "inches"
    assert from_trimesh(mesh).volume == pytest.approx(25.4**3, rel=1e-9)


def test_save_refuses_other_formats(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="stl"):
        block().save(tmp_path / "part.docx")


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("nothing.stl", b"", EmptyMesh),
        ("empty.stl", b"solid x\nendsolid x\n", MeshError),
        ("empty.ply", b"ply\nformat ascii 1.0\nelement vertex 0\nelement face 0\nend_header\n", MeshError),
        ("noise.stl", bytes(range(256)) * 3, MeshError),
        ("noise.3mf", b"not a zip archive", MeshError),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", EmptyMesh),
    ],
)
def test_unusable_files_are_typed_errors(tmp_path: Path, name: str, content: bytes, error: type[MeshError]) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(error):
        load_mesh(tmp_path / name)


def test_missing_files_and_unknown_formats(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="check the path"):
        load_mesh(tmp_path / "absent.stl")
    with pytest.raises(BadInput, match=r"\.3mf"):
        load_mesh(tmp_path / "part.iges")
    (tmp_path / "text.stl").write_text("a text that somebody renamed\n")
    with pytest.raises(EmptyMesh, match=r"'text\.stl' has no triangles: it is empty, or no STL file; expected"):
        load_mesh(tmp_path / "text.stl")


def test_solid_refuses_broken_arrays() -> None:
    good = block()
    with pytest.raises(EmptyMesh):
        Solid(good.vertices, np.zeros((0, 3), int))
    with pytest.raises(MeshError, match="NaN"):
        Solid(np.where(good.vertices > 0.0, np.nan, good.vertices), good.faces)
    with pytest.raises(MeshError, match="faces refer to"):
        Solid(good.vertices[:-1], good.faces)
    with pytest.raises(MeshError, match="expected"):
        Solid(good.vertices, good.faces[:, :2])
    with pytest.raises(ValueError, match="read-only"):
        good.vertices[0, 0] = 1.0


def mending(solid: Solid) -> Solid:
    """The repaired solid, once the warning has told what it records."""
    with pytest.warns(MeshWarning) as caught:
        result = repaired(solid)
    (warning,) = caught
    assert result.mended[-1] in str(warning.message) and solid.name in str(warning.message)
    return result


@pytest.mark.filterwarnings("error::vamgpu.errors.MeshWarning")
def test_a_sound_mesh_is_left_alone() -> None:
    part = block()
    assert repaired(part) is part
    loose = repaired(soup(part))  # as STL files are
    assert loose.open_edges == 0 and loose.mended == part.mended == ()


def test_loose_triangles_with_a_missing_one_are_closed() -> None:
    whole = soup(ball())
    part = Solid(whole.vertices, whole.faces[1:], "holed")
    mended = mending(part)
    assert mended.open_edges == 0
    assert mended.mended == ("1 hole closed (rims of up to 3 edges)",)
    assert mended.volume == pytest.approx(ball().volume, rel=1e-12)


def test_a_small_round_hole_is_filled() -> None:
    part = ball(4)
    pole = int(np.argmax(part.vertices[:, 2]))
    sides = np.count_nonzero(part.faces == pole)
    mended = mending(Solid(part.vertices, part.faces[(part.faces != pole).all(axis=1)]))
    assert mended.open_edges == 0
    assert mended.mended == (f"1 hole closed (rims of up to {sides} edges)",)
    assert mended.volume == pytest.approx(part.volume, rel=2e-3)


def test_cracks_below_the_tolerance_are_sewn() -> None:
    part = soup(ball())
    shaken = part.vertices + np.random.default_rng(1).uniform(-1e-6, 1e-6, part.vertices.shape)
    mended = mending(Solid(shaken, part.faces))
    assert mended.open_edges == 0
    joined_corners = len(part.vertices) - len(ball().vertices)
    assert mended.mended == (f"{joined_corners} corners along cracks joined to a neighbor",)
    assert mended.volume == pytest.approx(part.volume, rel=1e-5)


@pytest.mark.parametrize("share", [0.1, 0.9, 1.0])
def test_winding_is_made_outward(share: float) -> None:
    part = ball()
    flipped = np.random.default_rng(2).random(len(part.faces)) < share
    faces = np.where(flipped[:, None], part.faces[:, ::-1], part.faces)
    mended = mending(Solid(part.vertices, faces))
    assert mended.open_edges == 0
    assert mended.volume == pytest.approx(part.volume, rel=1e-12)
    few = min(flipped.sum(), (~flipped).sum())
    turned = f"{few} triangles turned to face as their neighbors do"
    outward = "1 body of 1 wound the wrong way, turned"
    assert mended.mended == {0.1: (turned,), 0.9: (turned, outward), 1.0: (outward,)}[share]


def test_repeated_and_empty_triangles_are_removed_and_told() -> None:
    part = ball()
    extra = np.array([[0, 1, 1], [3, 2, 3], [5, 5, 5]])
    mended = mending(Solid(part.vertices, np.concatenate([part.faces, part.faces[:2], extra])))
    assert mended.volume == pytest.approx(part.volume, rel=1e-12)
    assert mended.mended == ("3 triangles without area removed", "2 triangles that duplicated others removed")


def test_what_was_mended_stays_with_the_part(tmp_path: Path) -> None:
    part = ball()
    holed = Solid(part.vertices, part.faces[3:], "holed").save(tmp_path / "holed.ply")
    with pytest.warns(MeshWarning, match="holed: the mesh was repaired: . holes? closed"):
        target = Target.from_mesh(holed, height=3.0, pitch=0.5, device="numpy")
    assert target.solid is not None and target.mended == target.solid.mended
    assert target.mended[0].startswith(("1 hole closed", "2 holes closed", "3 holes closed"))
    again = Target.from_mesh(target.solid, height=2.0, pitch=0.5, orientation=QUARTER_TURN_ABOUT_X, device="numpy")
    assert again.mended == target.mended
    assert Target.from_array(target.numpy(), 0.5).mended == ()
    sound = Target.from_mesh(part, height=3.0, pitch=0.5, device="numpy")
    assert sound.mended == ()


def test_a_cavity_stays_a_cavity_and_a_neighbor_turned_inside_out_is_turned_back() -> None:
    outer, inner = ball(radius=2.0), ball(radius=1.0)
    hollow = joined(outer, Solid(inner.vertices, inner.faces[:, ::-1]))
    expected = outer.volume - inner.volume
    assert repaired(hollow).volume == pytest.approx(expected, rel=1e-12)
    assert mending(Solid(hollow.vertices, hollow.faces[:, ::-1])).volume == pytest.approx(expected, rel=1e-12)
    aside = inner.translated((5.0, 0.0, 0.0))
    both = mending(joined(outer, Solid(aside.vertices, aside.faces[:, ::-1])))
    assert both.mended == ("1 body of 2 wound the wrong way, turned",)
    assert both.volume == pytest.approx(outer.volume + inner.volume, rel=1e-12)


def test_a_large_hole_is_refused_with_the_number_of_open_edges() -> None:
    part = ball()
    cut = part.faces[part.vertices[part.faces][:, :, 2].mean(axis=1) < 0.3]
    opened = Solid(part.vertices, cut, "bowl")
    assert opened.open_edges > 10
    with pytest.raises(NotWatertight, match=rf"bowl: {opened.open_edges} open edges.*[Cc]lose the holes"):
        repaired(opened)


def test_a_folded_sheet_is_refused() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    with pytest.raises(MeshError, match="no volume"):
        repaired(Solid(corners, np.array([[0, 1, 2], [0, 2, 1]])))


def test_placing_rotates_then_scales_then_centers() -> None:
    part = block().translated((7.0, -3.0, 11.0)).placed(rotation=QUARTER_TURN_ABOUT_X, height=6.0)
    # The y edge of 3 mm now stands upright and is stretched to 6 mm.
    np.testing.assert_allclose(part.bounds, [[-2.0, -4.0, -3.0], [2.0, 4.0, 3.0]], atol=1e-12)
    assert part.volume == pytest.approx(24.0 * 8.0, rel=1e-12)
    assert part.height == pytest.approx(6.0)
    assert part.radius == pytest.approx(np.hypot(2.0, 4.0))
    assert block().placed(factor=0.5).volume == pytest.approx(3.0)


def test_a_moved_mesh_is_placed_the_same(tmp_path: Path) -> None:
    here = load_mesh(ball().save(tmp_path / "here.ply"), height=5.0)
    there = load_mesh(ball().translated((10.0, 10.0, 10.0)).save(tmp_path / "there.ply"), height=5.0)
    np.testing.assert_allclose(there.vertices[there.faces], here.vertices[here.faces], atol=1e-5)


@pytest.mark.parametrize(
    "wish",
    [
        {"height": 0.0},
        {"height": float("nan")},
        {"factor": -1.0},
        {"factor": float("inf")},
        {"height": 1.0, "factor": 1.0},
        {"rotation": np.eye(2)},
        {"rotation": 2.0 * np.eye(3)},
        {"rotation": np.diag([1.0, 1.0, -1.0])},
        {"rotation": np.full((3, 3), np.nan)},
    ],
)
def test_wrong_placements_are_refused(wish: dict[str, object]) -> None:
    with pytest.raises(BadInput):
        block().placed(**wish)  # pyright: ignore[reportArgumentType]


def test_centering_uses_the_smallest_circle_not_the_box() -> None:
    # A right triangle: the circle stands on the hypotenuse, the box center does too, but an acute one differs.
    prism = trimesh.creation.extrude_triangulation(np.array([[0.0, 0.0], [6.0, 0.0], [3.0, 4.0]]), [[0, 1, 2]], 2.0)
    part = from_trimesh(prism).centered()
    corners = np.unique(np.round(np.hypot(part.vertices[:, 0], part.vertices[:, 1]), 9))
    np.testing.assert_allclose(corners, 3.125, atol=1e-9)
    assert part.bounds[:, 2].sum() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_smallest_circle_equals_brute_force(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(9, 2)) * (3.0, 1.0) + 100.0
    x, y, radius = smallest_enclosing_circle(points)
    assert (np.hypot(points[:, 0] - x, points[:, 1] - y) <= radius * (1.0 + 1e-9)).all()
    best = np.inf
    for number in (2, 3):
        for chosen in combinations(points, number):
            # The center equidistant from the chosen points that lies in their plane hull.
            delta = np.array(chosen[1:]) - chosen[0]
            shift = np.linalg.lstsq(2.0 * delta, (delta**2).sum(axis=1), rcond=None)[0]
            reach = np.hypot(*shift)
            if (np.hypot(*(points - chosen[0] - shift).T) <= reach * (1.0 + 1e-9)).all():
                best = min(best, float(reach))
    assert radius == pytest.approx(best, rel=1e-9)


def test_smallest_circle_of_degenerate_points() -> None:
    assert smallest_enclosing_circle([(2.0, 3.0)]) == (2.0, 3.0, 0.0)
    assert smallest_enclosing_circle([(0.0, 0.0), (4.0, 0.0)]) == pytest.approx((2.0, 0.0, 2.0))
    line = [(t, 2.0 * t) for t in np.linspace(-1.0, 3.0, 9)]
    assert smallest_enclosing_circle(line) == pytest.approx((1.0, 2.0, 2.0 * np.sqrt(5.0)))
    assert smallest_enclosing_circle([(1.0, 1.0)] * 6) == pytest.approx((1.0, 1.0, 0.0))
    with pytest.raises(BadInput, match="expected"):
        smallest_enclosing_circle(np.zeros((0, 2)))


def _binary_stl(corners: np.ndarray, announced: int) -> bytes:
    facets = np.zeros(len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]))
    facets["corners"] = corners
    return bytes(80) + announced.to_bytes(4, "little") + facets.tobytes()


def test_binary_stl_that_is_cut_off_says_so(tmp_path):
    file = tmp_path / "cut.stl"
    file.write_bytes(_binary_stl(np.ones((3, 3, 3)), 12))
    with pytest.raises(MeshError, match="12 triangles but ends after 3"):
        load_mesh(file)


PLATE = trimesh.creation.box((10, 8, 4))
BINARY: Any = PLATE.export(file_type="stl")
TEXT = f"{PLATE.export(file_type='stl_ascii')}".encode()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (BINARY, None),
        (b"solid of a program".ljust(80) + BINARY[80:], None),
        (BINARY + bytes(60), "left out: 60 bytes after the last triangle"),
        (BINARY + b"\r\n", "2 bytes after"),
        (BINARY[:80] + bytes(4) + BINARY[84:], "counts 0 triangles, and 12 were read"),
        (BINARY[:80] + b"\xff" * 4 + BINARY[84:], "counts 4,294,967,295 triangles, and 12 were read"),
        (BINARY[:80] + b"\6\0\0\0" + BINARY[84:], "counts 6 triangles, and 12 were read"),
        (BINARY[:-1], "it ends inside triangle 12, its last, which was left out"),
        (BINARY[:-49], "it ends inside triangle 12"),
        (TEXT, None),
        (TEXT.upper(), None),
        (TEXT.replace(b"\n", b"\r"), None),
        (TEXT.replace(b"\n", b" "), None),
        (TEXT.replace(b".", b","), None),
        (TEXT.replace(b"solid", b"solid vertex 1 2 3", 1).replace(b"\xe9", b""), None),
        (b"\xef\xbb\xbf\n" + TEXT.replace(b"solid", b"solid \xe9", 1), None),
        (TEXT[: TEXT.rindex(b"endsolid")], "it has no line endsolid"),
        (TEXT[: TEXT.rindex(b"vertex")], "ends inside a triangle"),
    ],
)
def test_a_broken_stl_is_read_as_far_as_it_is_whole(data: bytes, said: str | None, tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(data)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        found = load_mesh(tmp_path / "a.stl")
    assert found.volume == pytest.approx(320.0) and len(found.faces) == 12
    if said is None:
        assert not warned and not found.mended
    else:
        assert any(said in str(each.message) for each in warned) and said in "; ".join(found.mended)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (BINARY[:-50], "12 triangles but ends after 11"),
        (BINARY[:-70], "12 triangles but ends after 10"),
        (TEXT.replace(b"vertex", b"corner", 1), "35 vertices in 12 triangles"),
        (TEXT.replace(b"vertex 5.0", b"vertex nan", 1), "1 of 12 triangles"),
        (TEXT.replace(b"vertex 5.0", b"vertex five", 1), "expected three numbers"),
        (b"solid a\nendsolid a\n", "no triangles"),
    ],
)
def test_an_stl_that_is_not_whole_is_refused_with_the_cause(data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(data)
    with pytest.raises(MeshError, match=said):
        load_mesh(tmp_path / "a.stl")


def _ply(order: str, faces: list[tuple[int, ...]], more: bytes = b"") -> bytes:
    """A box with texture coordinates at its faces; the order of bytes, or none for text."""
    corners = [(x, y, z) for x in (0, 10) for y in (0, 8) for z in (0, 4)]
    form = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = (f"ply\nformat {form} 1.0\ncomment of a program\nelement vertex 8\nproperty double x\nproperty float y\n"
            f"property short z\nproperty uchar red\nelement face {len(faces)}\nproperty list uchar float texcoord\n"
            "property list uchar int vertex_indices\nproperty uchar flags\nend_header\n").encode()  # fmt: skip
    if not order:
        rows = ["{} {} {} 7".format(*each) for each in corners]
        rows += [f"2 .5 .5 {len(face)} {' '.join(map(str, face))} 1" for face in faces]
        return head + "\n".join(rows).encode() + more
    rows = [struct.pack(f"{order}dfhB", *each, 7) for each in corners]
    rows += [struct.pack(f"{order}B2fB{len(face)}iB", 2, 0.5, 0.5, len(face), *face, 1) for face in faces]
    return head + b"".join(rows) + more


QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
MIXED = [*QUADS[:5], (1, 5, 7), (1, 7, 3)]


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("faces", [QUADS, MIXED], ids=["quads", "mixed"])
def test_ply_of_any_encoding_and_faces_is_read(order: str, faces: list[tuple[int, ...]], tmp_path: Path) -> None:
    file = tmp_path / "a.ply"
    file.write_bytes(_ply(order, faces))
    assert load_mesh(file).volume == pytest.approx(320.0)
    file.write_bytes(_ply(order, faces, b" 1" * 8))
    with pytest.warns(MeshWarning, match="after the last row were left out"):
        assert load_mesh(file).volume == pytest.approx(320.0)
    file.write_bytes(_ply(order, faces)[:-9])
    with pytest.raises(MeshError, match=rf"last of its {len(faces)} rows of 'face'; it is cut off"):
        load_mesh(file)
    file.write_bytes(_ply(order, [*faces, (0, 1, 8)]))
    with pytest.raises(MeshError, match="vertices 0 to 8 among 8"):
        load_mesh(file)


def test_binary_stl_with_nan_is_refused(tmp_path):
    corners = np.random.default_rng(0).random((8, 3, 3))
    corners[2, 1, 0] = np.nan
    file = tmp_path / "nan.stl"
    file.write_bytes(_binary_stl(corners, 8))
    with pytest.raises(MeshError, match="1 of 8 triangles have corners that are NaN"):
        load_mesh(file)


def test_text_in_another_encoding_is_read(tmp_path):
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    file = tmp_path / "part.obj"
    file.write_bytes("# Gerät\n".encode("latin-1") + corners.encode())
    assert load_mesh(file).volume == pytest.approx(1 / 6)


def test_corners_of_a_file_are_merged_as_by_trimesh() -> None:
    """Corners a ten-billionth apart are one vertex, also on either side of 0; the order is that of the file."""
    ball = trimesh.creation.icosphere(2, 7.0)
    corners = np.random.default_rng(1).permutation(ball.vertices[ball.faces])
    corners += np.random.default_rng(2).choice([-1e-10, 0.0, 1e-10], corners.shape)
    expected = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    found = Mesh.of(corners)
    assert len(found.vertices) == len(ball.vertices)
    assert np.array_equal(found.vertices, expected.vertices) and np.array_equal(found.faces, expected.faces)
