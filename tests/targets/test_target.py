"""Targets: the grid around a part, where their fractions live, and the errors for what cannot be a target."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, EmptyMesh, NotWatertight, OutOfMemory, TargetTooLarge
from vamgpu.geometry import Grid
from vamgpu.targets import shapes
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.shapes import csg
from vamgpu.targets.solid import Solid
from vamgpu.targets.target import Target

BENCHY = Path(__file__).parents[3] / "shared" / "data" / "benchy.stl"


@pytest.fixture(scope="module", params=["boat", *(["benchy"] if BENCHY.exists() else [])])
def boat(request: pytest.FixtureRequest) -> Solid:
    """The bundled boat, and the 3DBenchy where it lies beside the project."""
    return load_mesh(BENCHY) if request.param == "benchy" else shapes.build("boat")


def wedge() -> Solid:
    """A part without any symmetry, off the axis."""
    mesh = trimesh.convex.convex_hull(np.array([(1, 1, 0), (4, 1, 0), (1, 3, 0), (1, 1, 5), (3, 2, 2.5)], float))
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "wedge")


def test_a_boat_fills_the_volume_of_its_mesh(boat: Solid, fast_device: Device) -> None:
    target = Target.from_mesh(boat, height=11.5, pitch=11.5 / 128, device=fast_device)
    assert target.grid.shape[2] == 128
    assert target.volume == pytest.approx(boat.scaled(11.5 / boat.height).volume, rel=1e-3)
    assert target.height == pytest.approx(11.5)


@pytest.fixture(scope="module")
def voxels_by_definition(boat: Solid) -> np.ndarray:
    return Target.from_mesh(boat, 11.5, pitch=11.5 / 24, device="numpy").numpy()


@pytest.mark.slow
def test_a_boat_is_the_same_on_every_device(boat: Solid, voxels_by_definition: np.ndarray, fast_device: Device) -> None:
    target = Target.from_mesh(boat, 11.5, pitch=11.5 / 24, device=fast_device)
    np.testing.assert_array_equal(target.numpy(), voxels_by_definition)


def test_a_moved_mesh_gives_the_same_voxels(boat: Solid, fast_device: Device) -> None:
    for solid, pitch in ((boat, 11.5 / 32), (wedge(), 0.1)):
        here = Target.from_mesh(solid, height=11.5, pitch=pitch, device=fast_device)
        there = Target.from_mesh(solid.translated((10.0, 10.0, 10.0)), height=11.5, pitch=pitch, device=fast_device)
        assert here.grid == there.grid
        np.testing.assert_array_equal(here.numpy(), there.numpy())


def test_a_file_is_a_target_as_its_solid_is(tmp_path: Path) -> None:
    file = wedge().save(tmp_path / "part.ply")
    target = Target.from_mesh(file, height=5.0, pitch=0.25, device="numpy")
    assert target.name == "part"
    assert Target.from_mesh(str(file), 5.0, pitch=0.25, name="other", device="numpy").name == "other"
    np.testing.assert_allclose(
        target.numpy(), Target.from_mesh(wedge(), height=5.0, pitch=0.25, device="numpy").numpy(), atol=1e-2
    )


@pytest.mark.parametrize("margin", [0, 1, 2, 7])
@pytest.mark.parametrize("pitch", [0.1, 0.25, 0.31])
def test_the_grid_is_just_large_enough(margin: int, pitch: float) -> None:
    target = Target.from_mesh(wedge(), factor=1.0, pitch=pitch, margin=margin, device="numpy")
    nx, ny, nz = target.grid.shape
    assert nx == ny and nx % 4 == 0 and nz % 4 == 0
    assert target.radius + margin * pitch <= target.grid.inscribed_radius + 1e-6
    assert target.height <= nz * pitch + 1e-6
    assert target.radius + margin * pitch > 0.5 * (nx - 5) * pitch
    assert target.height > (nz - 4) * pitch
    filled = target.numpy() > 0
    assert not filled[~target.grid.cylinder()].any() or margin == 0


def test_whole_voxels_of_height_need_no_extra_slice() -> None:
    for slices in (128, 120, 36):
        assert Target.from_mesh(wedge(), height=11.5, pitch=11.5 / slices, device="numpy").grid.shape[2] == slices


def test_orientation_turns_before_scaling() -> None:
    lying = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    target = Target.from_mesh(wedge(), height=6.0, pitch=0.25, orientation=lying, device="numpy")
    assert target.height == pytest.approx(6.0)
    assert target.volume == pytest.approx(wedge().volume * 2.0**3, rel=0.01)  # x was 3 mm long
    with pytest.raises(BadInput, match="orthogonal"):
        Target.from_mesh(wedge(), height=6.0, pitch=0.25, orientation=2.0 * lying)


def test_a_given_shape_is_kept_or_refused() -> None:
    target = Target.from_mesh(wedge(), height=5.0, pitch=0.2, shape=(41, 37, 30), device="numpy")
    assert target.grid == Grid((41, 37, 30), 0.2)
    for shape in ((16, 64, 40), (64, 16, 40), (64, 64, 24)):
        with pytest.raises(TargetTooLarge, match=r"radius .* height .* use shape \(\d+, \d+, 25\)"):
            Target.from_mesh(wedge(), height=5.0, pitch=0.2, shape=shape)
    with pytest.raises(BadInput, match="shape"):
        Target.from_mesh(wedge(), height=5.0, pitch=0.2, shape=(64, 64))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pitch": float("nan"), "height": 5.0}, "pitch"),
        ({"pitch": -0.1, "height": 5.0}, "pitch"),
        ({"pitch": 0.0, "height": 5.0}, "pitch"),
        ({"pitch": "45 kg", "height": 5.0}, "pitch"),
        ({"pitch": 0.1}, "neither"),
        ({"pitch": 0.1, "height": 5.0, "factor": 1.0}, "one of them"),
        ({"pitch": 0.1, "height": -5.0}, "height"),
        ({"pitch": 0.1, "height": float("inf")}, "height"),
        ({"pitch": 0.1, "factor": 0.0}, "factor"),
        ({"pitch": 0.1, "factor": 1.0, "margin": -1}, "margin"),
        ({"pitch": 0.1, "factor": 1.0, "margin": 1.5}, "margin"),
    ],
)
def test_wrong_numbers_are_named(options: dict, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        Target.from_mesh(wedge(), **options)


def test_what_is_no_part_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="ndarray"):
        Target.from_mesh(np.zeros((3, 3)), height=1.0, pitch=0.1)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match=r"no-such\.stl"):
        Target.from_mesh(tmp_path / "no-such.stl", height=1.0, pitch=0.1)
    plate = csg.to_solid(csg.box((0.0, 0.0, 0.0), (10.0, 10.0, 1e-4)), "plate")
    with pytest.raises(EmptyMesh, match="no voxel of 5 mm is filled"):
        Target.from_mesh(plate, factor=1.0, pitch=5.0, device="numpy")
    with pytest.raises(BadInput, match="pitch is 20 mm, and the part is 10 mm at its longest"):
        Target.from_mesh(plate, factor=1.0, pitch=20.0, device="numpy")


def test_a_trimesh_is_a_target_as_its_file_is(tmp_path: Path) -> None:
    """In mm, or in the unit that it says; a body of a scene takes it alike."""
    mesh = trimesh.creation.annulus(1.0, 2.0, 3.0)
    mesh.export(tmp_path / "ring.ply")
    wanted = Target.from_mesh(tmp_path / "ring.ply", factor=1.0, pitch=0.25, device="numpy")
    found = Target.from_mesh(mesh, factor=1.0, pitch=0.25, device="numpy")
    np.testing.assert_array_equal(found.numpy(), wanted.numpy())
    assert found.solid is not None and (wanted.name, found.name) == ("ring", "solid")
    mesh.apply_scale(1e-3)
    mesh.units = "meter"
    named = Target.from_mesh(mesh, factor=1.0, pitch=0.25, device="numpy", name="washer")
    assert named.name == named.solid.name == "washer"  # type: ignore[union-attr]
    np.testing.assert_allclose(named.numpy(), wanted.numpy(), atol=1e-6)


@pytest.mark.parametrize(("scale", "options", "said"), [
    (1e-3, {"factor": 1.0}, r"is 0\.00\d+ mm at its longest; .* meant in m, write factor = 1000$"),
    (1e3, {"factor": 1.0}, r"is [\d.e+]+ mm at its longest; .* meant in um, write factor = 0\.001$"),
    (1.0, {"height": 0.005}, r'meant in m, write height = "5 mm"$'),
    (1.0, {"height": 5e9}, r"expected 0\.1 to 1000 mm: check the unit$"),
])  # fmt: skip
def test_the_unit_of_an_odd_part_is_asked_for(scale: float, options: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        Target.from_mesh(wedge().scaled(scale), pitch=0.1, device="numpy", **options)


@pytest.mark.parametrize(("thick", "thin"), [(0.2, True), (0.35, False)])
@pytest.mark.parametrize("degrees", [0.0, 20.0])
def test_walls_thinner_than_a_voxel_are_named(thick: float, thin: bool, degrees: float) -> None:
    plate = trimesh.creation.box((8, 4, thick))
    plate.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), (1, 1, 0)))
    scene = vamgpu.Scene([vamgpu.Body(plate)], origin=(0.0, 0.0, 0.125))
    for voxelize in (
        lambda: Target.from_mesh(plate, factor=1, pitch=0.25, device="numpy"),
        lambda: scene.target(pitch=0.25, device="numpy"),
    ):
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            voxelize()
        assert [f"about {0.186:g} mm thick, thinner" in str(each.message) for each in warned] == [True] * thin


def test_a_scene_too_large_for_a_vial_asks_for_the_unit() -> None:
    body = vamgpu.Body(trimesh.creation.box((10000, 8000, 4000)))
    with pytest.raises(BadInput, match=r"1\.281e\+04 mm wide .* at most: check the unit \(was it drawn in um\?\)"):
        vamgpu.Scene([body]).target(pitch=0.25, device="numpy")


def test_a_solid_is_repaired_as_a_file_is() -> None:
    wanted = Target.from_mesh(wedge(), height=5.0, pitch=0.5, device="numpy").numpy()
    inside_out = Solid(wedge().vertices, wedge().faces[:, ::-1])
    np.testing.assert_array_equal(Target.from_mesh(inside_out, height=5.0, pitch=0.5, device="numpy").numpy(), wanted)
    with pytest.raises(NotWatertight, match="open edges"):
        Target.from_mesh(_tube(), height=5.0, pitch=0.5, device="numpy")


def _tube() -> Solid:
    """A tube of 24 sides without its lids: its rims are too long to be filled."""
    mesh = trimesh.creation.cylinder(2.0, 5.0, sections=24)
    side = np.abs(mesh.face_normals[:, 2]) < 0.5
    return Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces)[side], "tube")


def test_too_large_for_memory_says_how_large() -> None:
    with pytest.raises((OutOfMemory, TargetTooLarge), match=r"[\d.]+ GB|voxels wide"):
        Target.from_mesh(wedge(), height=5.0, pitch=1e-5, device="numpy")
    with pytest.raises(OutOfMemory, match=r"takes \d+\.\d GB; this machine has"):
        Target.from_mesh(wedge(), height=5.0, pitch=2e-4, device="numpy")
    with pytest.raises(OutOfMemory, match=r"50\d(\.\d)? mm high, takes"):
        Target.from_mesh(wedge(), height=500.0, pitch=0.02, device="numpy")


def test_an_array_is_a_target() -> None:
    values = np.zeros((6, 8, 5))
    values[2:4, 3:5, 1:4] = 1.0
    values[3, 5, 2] = 0.25
    target = Target.from_array(values, 0.5, "cube")
    assert target.grid == Grid((6, 8, 5), 0.5)
    assert target.name == "cube"
    assert target.volume == pytest.approx((12 + 0.25) * 0.125)
    assert target.height == pytest.approx(1.5)
    assert target.radius == pytest.approx(np.hypot(0.25, 0.75))
    np.testing.assert_array_equal(target.numpy(), values)
    values[:] = 0.0
    assert target.numpy().any()
    assert Target.from_array(np.ones((2, 2, 2), bool), 1.0).volume == pytest.approx(8.0)


@pytest.mark.parametrize(
    "values",
    [
        np.ones((3, 3)),
        np.ones((3, 0, 3)),
        np.full((2, 2, 2), np.nan),
        np.full((2, 2, 2), 1.5),
        np.full((2, 2, 2), -0.1),
        np.full((2, 2, 2), 1j),
        np.full((2, 2, 2), "a"),
    ],
    ids=["2-D", "no voxels", "NaN", "above 1", "below 0", "complex", "text"],
)
def test_arrays_that_are_no_fractions_are_refused(values: np.ndarray) -> None:
    with pytest.raises(BadInput, match="expected"):
        Target.from_array(values, 0.1)


def test_empty_arrays_and_wrong_pitches_are_refused() -> None:
    with pytest.raises(EmptyMesh, match="every voxel"):
        Target.from_array(np.zeros((2, 2, 2)), 0.1)
    for pitch in (float("nan"), -1.0, 0.0):
        with pytest.raises(BadInput, match="pitch"):
            Target.from_array(np.ones((2, 2, 2)), pitch)


def test_fractions_move_to_a_device_once(device: Device) -> None:
    target = Target.from_array(np.random.default_rng(1).random((5, 6, 7)), 0.5)
    there = target.on(device)
    assert there.device is device
    assert target.on(device.name if device.name in vamgpu.devices() else device) is there
    np.testing.assert_array_equal(there.numpy(), target.numpy())
    made = Target.from_mesh(wedge(), height=5.0, pitch=0.5, device=device)
    assert made.on(device) is made.fraction
    np.testing.assert_array_equal(made.on("numpy").numpy(), made.numpy())


def test_a_mesh_target_stays_on_its_device(fast_device: Device) -> None:
    solid = shapes.build("exposure_disk")
    device = vamgpu.open_device(fast_device)
    before = len(device.ledger.transfers)
    target = Target.from_mesh(solid, factor=1.0, pitch=0.067, device=device)
    crossed = device.ledger.transfers[before:]
    assert all(direction == "upload" or size < target.on(device).nbytes / 20 for direction, size in crossed)
    with device.no_transfers():
        target.on(device)
    assert target.volume == pytest.approx(solid.volume, rel=1e-3)
    edge = target.numpy()[:, :, target.grid.shape[2] // 2]
    assert ((edge > 0.0) & (edge < 1.0)).any()  # edges are gray
