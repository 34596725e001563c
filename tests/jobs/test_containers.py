"""Containers, resins and lenses of Dr.TVAM: light goes where Snell's law puts it, numbers arrive in the job."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import vamgpu as vam
from vamgpu.chemistry.diffusion import Diffusion
from vamgpu.errors import BadInput, OpticsWarning
from vamgpu.jobs.build import projection_of, target_of
from vamgpu.jobs.foreign.drtvam import read_drtvam
from vamgpu.jobs.foreign.importing import import_task
from vamgpu.jobs.read import Job, read_job

MEDIUM = {"ior": 1.347, "extinction": 0.03, "albedo": 0.0}
SQUARE = {"type": "square", "w_int": 7.0, "w_ext": 8.0, "ior": 1.54, "medium": MEDIUM}
TUBE = {
    "type": "double_cylindrical", "r_ext_outer": 5.0, "r_int_outer": 4.5, "ior_outer": 1.53, "r_ext_inner": 2.0,
    "r_int_inner": 1.5, "ior_inner": 1.55, "ior_inside_inner": 1.33, "medium": MEDIUM,
}  # fmt: skip
ROUND = {"type": "cylindrical", "r_int": 4.5, "r_ext": 5.0, "ior": 1.54, "medium": MEDIUM}
ANGLES, PIXEL = 36, 0.2


def imported(
    folder: Path, vial: dict[str, Any], projector: dict[str, Any] | None = None, fine: int = 1, **more: Any
) -> Job:
    """The job of a configuration for a small plate that is off the axis."""
    box = trimesh.creation.box((1.0, 0.8, 0.6))
    box.apply_translation((2.8, 0.0, 0.0) if vial["type"] == "double_cylindrical" else (0.3, 0.0, 0.0))
    box.export(folder / "box.ply")
    said = {
        "vial": vial,
        "projector": {"type": "collimated", "n_patterns": ANGLES, "resx": 60, "resy": 6, "pixel_size": PIXEL,
                      "motion": "circular", "distance": 20, **(projector or {})},
        "sensor": {"type": "dda", "scalex": 2, "scaley": 2, "scalez": 1,
                   "film": {"resx": 20 * fine, "resy": 20 * fine, "resz": 10 * fine}},
        "target": {"filename": "box.ply", "scale_and_center": False},
        **more,
    }  # fmt: skip
    (folder / "config.json").write_text(json.dumps(said), encoding="utf-8")
    import_task(folder / "config.json", folder / "job.toml", overwrite=True)
    return read_job(folder / "job.toml")


def projector_of(job: Job) -> Any:
    device = vam.open_device("cpu")
    return projection_of(job.file, target_of(job, device), device, job.folder)


def light_of(A: Any, angle: int, column: int) -> tuple[np.ndarray, ...]:
    """Places x and y [mm] of the voxels of the middle slice, and the dose of one lit column there."""
    sinogram = np.zeros(A.range.shape, np.float32)
    sinogram[angle, column] = 1.0
    x, y, z = A.grid.axes()
    return *np.meshgrid(x, y, indexing="ij"), A.T(sinogram)[:, :, len(z) // 2]


def bent(heading: np.ndarray, normal: np.ndarray, before: float, after: float) -> np.ndarray:
    """Snell's law for a normal against the light."""
    cosine, ratio = -heading @ normal, before / after
    return ratio * heading + (ratio * cosine - np.emath.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))) * normal


def through_square(u: float, theta: float) -> tuple[np.ndarray, np.ndarray]:
    """A point and the heading in the resin of a ray that crosses both faces of a square wall."""
    heading = -np.array([np.cos(theta), np.sin(theta)])
    place = u * np.array([-np.sin(theta), np.cos(theta)]) - 50.0 * heading
    for half, before, after in ((4.0, 1.0, 1.54), (3.5, 1.54, 1.347)):
        faces = [(axis, -float(np.sign(heading[axis]))) for axis in (0, 1) if abs(heading[axis]) > 1e-9]
        hit = max(
            faces, key=lambda face: (face[1] * half - place[face[0]]) / heading[face[0]]
        )  # the later of two lines
        axis, side = hit
        place = place + (side * half - place[axis]) / heading[axis] * heading
        heading = bent(heading, side * np.eye(2)[axis], before, after)
    return place, heading


def test_light_refracts_at_the_walls_of_a_square_vial_that_turns(tmp_path: Path) -> None:
    job = imported(tmp_path, SQUARE)
    A = projector_of(job)
    assert job.file.vat is not None and [body.name for body in job.file.body[1:]] == ["surroundings", "wall"]
    off = []
    for angle in range(9):  # all turns of a square, to its symmetry
        for column in (24, 29, 33):
            u, theta = float(A.beam.columns()[column]), float(A.motion.poses[angle])
            place, heading = through_square(u, theta)
            sides = [through_square(u + side * PIXEL, theta)[1] for side in (-2.0, 2.0)]
            if not np.allclose(sides, heading):
                continue  # near a corner, where walls bend light within a voxel
            x, y, dose = light_of(A, angle, column)
            beside = (y - place[1]) * heading[0] - (x - place[0]) * heading[1]
            inside = (np.hypot(x, y) < 2.5) & (dose > 0)
            off.append(np.average(beside[inside], weights=dose[inside]))
    assert len(off) > 20 and np.median(np.abs(off)) < 0.002 and np.max(np.abs(off)) < 0.03  # of voxels of 0.1 mm


def test_light_in_a_square_vial_is_absorbed_by_the_resin_alone(tmp_path: Path) -> None:
    """Straight through two faces: exp(−μ·depth behind the inner face)."""
    A = projector_of(imported(tmp_path, SQUARE | {"medium": MEDIUM | {"extinction": 0.3}}))
    x, _, dose = light_of(A, 0, 30)
    lit = dose.sum(axis=1)
    wall, depth = np.abs(x[:, 0]) > 3.6, 3.5 - x[:, 0]
    assert lit[wall].max() < 1e-6 * lit.max()
    some = np.abs(x[:, 0]) < 3.0
    slope, _ = np.polyfit(depth[some], np.log(lit[some]), 1)
    assert slope == pytest.approx(-0.3, rel=0.01)


def test_light_passes_a_tube_in_the_resin_at_the_distance_that_the_indices_give(tmp_path: Path) -> None:
    """n·p is the same in all layers about one axis, so that p = u / n."""
    job = imported(tmp_path, TUBE, fine=2)
    assert [(body.name, body.index) for body in job.file.body] == [(None, None), ("tube", 1.55), ("core", 1.33)]
    with pytest.warns(OpticsWarning, match="2 of 6480 rays are guided in the medium"):
        A = projector_of(job)
    for column in (32, 34):
        u = float(A.beam.columns()[column])
        x, y, dose = light_of(A, 0, column)
        slopes = []
        for side in (1.0, -1.0):  # before the tube and behind it
            rows = (side * x[:, 0] > 2.1) & (side * x[:, 0] < 3.0)
            slope, level = np.polyfit(x[rows, 0], np.average(y[rows], axis=1, weights=dose[rows]), 1)
            slopes.append(np.arctan(slope))
            assert abs(level) / np.hypot(1.0, slope) == pytest.approx(abs(u) / 1.347, abs=0.01)
        sines = [np.arcsin(u / (radius * n)) for radius, n in ((2.0, 1.347), (2.0, 1.55), (1.5, 1.55), (1.5, 1.33))]
        turn = 2.0 * (sines[0] - sines[1] + sines[2] - sines[3])
        assert abs(turn) > 0.02 and abs(slopes[1] - slopes[0]) == pytest.approx(
            abs(turn), abs=0.01
        )  # a fifth of a voxel in a millimeter
    x, y, dose = light_of(A, 0, 32)
    assert dose[np.hypot(x, y) < 1.9].max() < 1e-6 * dose.max()  # only resin absorbs


def test_a_meshed_vial_is_the_square_one_of_its_meshes(tmp_path: Path) -> None:
    for side, name in ((8.0, "outer"), (7.0, "inner")):
        trimesh.creation.box((side, side, 100.0)).export(tmp_path / f"{name}.ply")
    same = projector_of(imported(tmp_path, SQUARE))
    custom = {"type": "custom", "filename_vial_outer": "outer.ply", "filename_vial_inner": "inner.ply", "ior": 1.54}
    A = projector_of(imported(tmp_path, {**custom, "medium": MEDIUM}))
    assert A.grid == same.grid and np.array_equal(light_of(A, 3, 33)[2], light_of(same, 3, 33)[2])
    with pytest.raises(BadInput, match="container has no wall.*one inside the other"):
        imported(tmp_path, {**custom, "filename_vial_inner": "outer.ply", "medium": MEDIUM})


def test_a_lens_is_a_cone_from_its_pupil(tmp_path: Path) -> None:
    matched = {"type": "index_matched", "r": 4.0, "medium": MEDIUM}
    lens = {"type": "lens", "aperture_radius": 0.01, "focus_distance": 25.0}
    job = imported(tmp_path, matched, lens)
    A = projector_of(job)
    assert A.beam.pitch == pytest.approx(PIXEL * 20 / 25)
    x, y, dose = light_of(A, 0, 33)
    row = np.average(y, axis=1, weights=np.maximum(dose, 1e-12))
    lit = dose.max(axis=1) > 0
    expected = 3.5 * PIXEL / 25.0 * (20.0 - x[:, 0])  # from the pupil at x = 20
    assert np.abs(row - expected)[lit].max() < 0.05 and lit.sum() > 10
    job = imported(tmp_path, matched, {**lens, "pixel_size": 1.0, "fov": 30.0})
    assert job.file.beam.pitch == pytest.approx(20 * 2 * np.tan(np.radians(15)) / 60)


def test_scattering_in_a_vat_is_left_out_with_a_note(tmp_path: Path) -> None:
    turbid = {"ior": 1.4, "extinction": 0.1, "albedo": 0.5, "phase": {"type": "rayleigh"}}
    vat = {"type": "index_matched", "r": 4.0, "medium": turbid}
    assert imported(tmp_path, vat).file.scattering is None
    notes = import_task(tmp_path / "config.json", tmp_path / "job.toml", overwrite=True)
    assert any("its resin scatters" in note for note in notes)


@pytest.mark.parametrize("vial", [ROUND, SQUARE, TUBE])
def test_a_lens_in_front_of_another_vial_is_a_fan_with_a_note(vial: dict[str, Any], tmp_path: Path) -> None:
    lens = {"type": "lens", "aperture_radius": 0.01, "focus_distance": 20.0}
    job = imported(tmp_path, vial, lens)
    assert job.file.vessel is not None and projector_of(job).range.shape == (ANGLES, 60, 6)
    notes = import_task(tmp_path / "config.json", tmp_path / "job.toml", overwrite=True)
    assert any("rows count as level" in note for note in notes) and any(
        "aperture is left out" in each for each in notes
    )


def test_metal_counts_as_black_with_a_note(tmp_path: Path) -> None:
    trimesh.creation.cylinder(0.3, 2.0).export(tmp_path / "rod.ply")
    rods: list[dict[str, Any]] = [
        {"filename": "rod.ply", "bsdf": {"type": kind}} for kind in ("roughconductor", "diffuse")
    ]
    job = imported(tmp_path, ROUND | {"occlusions": rods}, {"cropx": 30})
    assert [(body.role, body.index) for body in job.file.body[1:]] == 2 * [("insert", None)]
    notes = import_task(tmp_path / "config.json", tmp_path / "job.toml", overwrite=True)
    assert "reflections at rod.ply are left out: it counts as black" in notes
    assert "its crop is left out: pixels beyond it may be lit" in notes
    with pytest.raises(BadInput, match="surface .*roughdielectric.*expected a dielectric or one of"):
        imported(tmp_path, ROUND | {"occlusions": [{"filename": "rod.ply", "bsdf": {"type": "roughdielectric"}}]})


def test_a_large_container_gets_wider_voxels_and_is_told(tmp_path: Path) -> None:
    job = imported(tmp_path, SQUARE, fine=5)  # voxels of 0.02 mm, and 8 mm · √2
    assert job.file.target.shape_of_grid is not None and job.file.target.shape_of_grid[0] == 512
    assert job.file.target.pitch == pytest.approx(8.0 * np.sqrt(2.0) / 506)
    notes = import_task(tmp_path / "config.json", tmp_path / "job.toml", overwrite=True)
    assert any("voxels are 0.0224 mm wide, not 0.02" in note for note in notes)


@pytest.mark.parametrize(
    ("phase", "anisotropy"),
    [({"type": "rayleigh"}, "rayleigh"), ({"type": "hg", "g": 0.95}, 0.95), ({"type": "isotropic"}, 0.0)],
)
def test_resin_that_scatters_keeps_its_coefficients(phase: dict[str, Any], anisotropy: Any, tmp_path: Path) -> None:
    medium = {"ior": 1.4, "extinction": 0.2, "albedo": 0.75, "phase": phase}
    job = imported(tmp_path, ROUND | {"medium": medium})
    found = job.file.scattering() if job.file.scattering is not None else None
    assert found is not None and found.coefficient == pytest.approx(0.15) and found.anisotropy == anisotropy
    assert job.file.vial is not None and job.file.vial.absorption == pytest.approx(0.05)


@pytest.mark.parametrize(("vial", "phase"), [(ROUND, {"type": "sggx"}), (ROUND, {}), (SQUARE, {"type": "rayleigh"})])
def test_scattering_that_cannot_be_computed_is_told(vial: Any, phase: Any, tmp_path: Path) -> None:
    medium = {"ior": 1.4, "extinction": 0.2, "albedo": 0.75, "phase": phase}
    job = imported(tmp_path, vial | {"medium": medium})
    assert job.file.scattering is None
    notes = import_task(tmp_path / "config.json", tmp_path / "job.toml", overwrite=True)
    assert any("resin scatters (albedo 0.75" in note and "0.25 of its extinction" in note for note in notes)


def test_an_inhibitor_that_diffuses_becomes_the_diffusion_of_the_resin(tmp_path: Path) -> None:
    model = {"type": "inhibitor_diffusion", "diffusion_coefficient": 2e-4, "number_time_steps": 10}
    job = imported(tmp_path, ROUND, physical_model=model, print_time=30.0)
    assert job.file.resin.diffusion == Diffusion(2e-4, 30.0)
    older = {"type": "gaussian", "D": 1e-4, "printing_time": 20.0, "number_rotations": 4}
    diffusion = imported(tmp_path, ROUND, diffusion=older).file.resin.diffusion
    assert diffusion is not None and (diffusion.diffusivity, diffusion.seconds) == (1e-4, 20.0)
    plain = imported(tmp_path, ROUND, physical_model={"type": "inhibitor", "inhibitor_init": "a.npy"})
    assert plain.file.resin.diffusion is None
    notes = import_task(tmp_path / "config.json", tmp_path / "job.toml", overwrite=True)
    assert "its physical_model.inhibitor_init is left out: the inhibitor is the same everywhere" in notes
    with pytest.raises(BadInput, match="physical_model is 'oxygen'; expected inhibitor or"):
        imported(tmp_path, ROUND, physical_model={"type": "oxygen"})
    with pytest.raises(BadInput, match="lacks 'print_time'"):
        imported(tmp_path, ROUND, physical_model=model)


def test_weights_of_a_loss_become_that_of_the_part(tmp_path: Path) -> None:
    job = imported(tmp_path, ROUND, loss={"type": "threshold", "weight_object": 2, "weight_void": 0.8})
    assert job.file.body[0].weight == pytest.approx(2.5)
    assert imported(tmp_path, ROUND, loss={"type": "threshold"}).file.body[0].weight == 1.0


def test_meshes_are_found_beside_the_configuration_or_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "deep").mkdir()
    imported(tmp_path, ROUND)
    (tmp_path / "config.json").rename(tmp_path / "deep/config.json")
    monkeypatch.chdir(tmp_path)
    import_task(tmp_path / "deep/config.json", tmp_path / "again.toml")
    assert (tmp_path / "again-part.ply").is_file()


def test_patterns_in_a_square_vial_need_a_job(tmp_path: Path) -> None:
    imported(tmp_path, SQUARE)
    np.savez(tmp_path / "patterns.npz", patterns=np.ones((ANGLES, 6, 60), np.float32))
    with pytest.raises(BadInput, match="container that is 'square'.*--out job.toml, then import its folder of EXR"):
        read_drtvam(tmp_path / "config.json")
