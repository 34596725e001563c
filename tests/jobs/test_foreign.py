"""Patterns of other programs: each convention against that program's own formula, and jobs of them that prove."""

from __future__ import annotations

import json
import os
import pickle
import sys
import types
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import vamgpu as vam
from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError, StorageError
from vamgpu.jobs.build import projection_of, target_of
from vamgpu.jobs.foreign.drtvam import export_drtvam, read_drtvam, write_drtvam
from vamgpu.jobs.foreign.importing import import_patterns, import_task
from vamgpu.jobs.foreign.patterns import STEPPED
from vamgpu.jobs.foreign.pictures import Layout, read_pictures
from vamgpu.jobs.foreign.vamtoolbox import read_vamtoolbox
from vamgpu.jobs.read import read_job
from vamgpu.jobs.run import prove
from vamgpu.printing.export import export
from vamgpu.printing.gray import GrayCurve
from vamgpu.storage.folder import Folder
from vamgpu.storage.images import encode_png
from vamgpu.storage.pickles import read_pickle
from vamgpu.targets import shapes

PITCH = 0.5
MEDIUM = {"ior": 1.4, "extinction": 0.1, "albedo": 0.0}
VIAL = {"type": "cylindrical", "r_int": 7, "r_ext": 8, "ior": 1.54, "medium": MEDIUM}
MATCHED = {"type": "index_matched", "r": 7, "medium": MEDIUM}


def configuration(folder: Path, angles: int = 24, **changes: Any) -> Path:
    """A configuration of Dr.TVAM for a box that is off its axis."""
    box = trimesh.creation.box((4, 3, 2))
    box.apply_translation((10, 5, 3))
    box.export(folder / "box.ply")
    said = {
        "vial": VIAL,
        "projector": {"type": "collimated", "n_patterns": angles, "resx": 24, "resy": 8, "pixel_size": PITCH,
                      "motion": "circular", "distance": 20},
        "sensor": {"type": "dda", "scalex": 6, "scaley": 6, "scalez": 4, "film": {"resx": 12, "resy": 12, "resz": 8}},
        "target": {"filename": "box.ply", "size": 4.0, "box_center_x": 0.75, "box_center_y": -0.5, "box_center_z": 0.4},
    }  # fmt: skip
    (folder / "config.json").write_text(json.dumps({**said, **changes}), encoding="utf-8")
    return folder / "config.json"


def ray(pattern: int, row: int, column: int, clockwise: bool) -> tuple[np.ndarray, np.ndarray]:
    """A point and the direction of a pixel's ray as Dr.TVAM's projector looks at the axis, from Mitsuba's look_at."""
    alpha = 2.0 * np.pi * pattern / 24 * (-1.0 if clockwise else 1.0)
    origin = 20.0 * np.array([np.cos(alpha), np.sin(alpha), 0.0])
    forward = -origin / 20.0
    left = np.cross((0.0, 0.0, 1.0), forward)
    up = np.cross(forward, left)
    x, y = (1.0 - 2.0 * (column + 0.5) / 24) * 12 * PITCH, (1.0 - 2.0 * (row + 0.5) / 8) * 4 * PITCH
    return origin + x * left + y * up, forward


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("pixel", [(5, 2, 8), (17, 6, 15)])
def test_a_pixel_of_dr_tvam_lights_the_voxels_along_its_ray(
    pixel: tuple[int, int, int], clockwise: bool, tmp_path: Path
) -> None:
    patterns = np.zeros((24, 8, 24), np.float32)
    patterns[pixel] = 1.0
    np.savez(tmp_path / "patterns.npz", patterns=patterns)
    projector = {"type": "collimated", "resx": 24, "resy": 8, "pixel_size": PITCH, "clockwise": clockwise}
    path = configuration(tmp_path, vial=MATCHED, projector=projector)
    found = read_drtvam(path)
    device = vam.open_device("numpy")
    grid = vam.Grid((24, 24, 16), 0.25)
    A = vam.Projection(grid, vam.Beam((24, 8), PITCH, spread=0.0), vam.Turntable(24, lit_share=0), None, device)
    dose = A.T(device.upload(found.light)).numpy()
    start, along = ray(*pixel, clockwise)
    places = np.stack(np.meshgrid(*grid.axes(), indexing="ij"), axis=-1) - start
    away = np.linalg.norm(np.cross(places, along), axis=-1)
    assert dose.max() > 0.0 and away[dose > 0.1 * dose.max()].max() < 0.75 * PITCH
    assert (dose[away < 0.2 * PITCH] > 0.5 * dose.max()).all()


def test_a_configuration_of_dr_tvam_becomes_a_job_that_proves(tmp_path: Path) -> None:
    np.savez(tmp_path / "patterns.npz", patterns=np.ones((24, 8, 24), np.float32))
    path = configuration(tmp_path)
    done = import_patterns(path, tmp_path / "flat.vam", device="cpu")
    flat = prove(done.folder.path).proof
    plan: Any = vam.load(tmp_path / "flat.vam", "cpu")
    A, part = plan.plan.operator, plan.plan.target
    assert (A.vessel.radius, A.vessel.inner_radius, A.vessel.absorption) == (8.0, 7.0, 0.1)
    assert (A.beam.pitch, A.beam.pixels, A.motion, A.grid.pitch) == (
        PITCH,
        (24, 8),
        vam.Turntable(24, lit_share=0),
        0.5,
    )
    places = np.argwhere(part.numpy() > 0.5) * 0.5 - 0.25 * (np.array(A.grid.shape) - 1) * 2 * 0.5
    assert np.allclose(places.mean(axis=0), (0.75, -0.5, 0.4), atol=0.26) and part.height == pytest.approx(2.0)
    write_drtvam(vam.optimize(A, part, iterations=8).sinogram.numpy(), tmp_path / "patterns.npz")
    import_patterns(path, tmp_path / "good.vam", device="cpu")
    good = prove(tmp_path / "good.vam", "cpu")
    assert not good.plan.history and good.proof.scores.iou > 0.9 > flat.scores.iou
    said = Folder.open(tmp_path / "good.vam").manifest.inputs["imported"]
    assert said["program"] == "Dr.TVAM" and said["source"] == "config.json"


def test_patterns_of_dr_tvam_are_judged_in_all_of_its_sensor_that_lies_in_resin(tmp_path: Path) -> None:
    np.savez(tmp_path / "patterns.npz", patterns=np.ones((24, 8, 24), np.float32))
    film = {"resx": 80, "resy": 26, "resz": 20}
    path = configuration(tmp_path, sensor={"type": "dda", "scalex": 40, "scaley": 13, "scalez": 10, "film": film})
    import_patterns(path, tmp_path / "flat.vam", device="cpu")
    flat: Any = vam.load(tmp_path / "flat.vam", "cpu")
    assert flat.plan.operator.grid == vam.Grid((28, 26, 20), 0.5)  # 14 mm of resin


def test_a_configuration_without_patterns_becomes_a_job_to_be_solved(tmp_path: Path) -> None:
    path, place = configuration(tmp_path, loss={"type": "threshold"}, n_steps=40), tmp_path / "box.toml"
    assert import_task(path, place) == (STEPPED, "its loss, n_steps left out: `vam solve` has methods of its own")
    job = read_job(place)
    assert job.file.turntable.lit_share == 0.0
    assert (job.file.beam.pixels, job.file.beam.pitch, job.file.target.pitch) == ((24, 8), PITCH, 0.5)
    part = target_of(job, vam.open_device("numpy"))
    places = np.argwhere(part.numpy() > 0.5) * 0.5 - 0.25 * (np.array(part.grid.shape) - 1)
    assert np.allclose(places.mean(axis=0), (0.75, -0.5, 0.4), atol=0.26)
    with pytest.raises(StorageError, match=r"box.toml.* exists"):
        import_task(path, place)
    place.unlink()
    with pytest.raises(StorageError, match=r"box-part.ply.* exists"):
        import_task(path, place)
    with pytest.raises(BadInput, match=r"is not one; import patterns into a folder"):
        import_task(tmp_path / "box.ply", place)
    assert main(["import", str(path), "--out", str(place), "--set", "vial.wall=2 mm"]) == 1 and not place.exists()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"vial": VIAL | {"type": "square", "w_int": 10, "w_ext": 12}}, "a container that is .square., without which"),
        ({"vial": VIAL | {"occlusions": [{"filename": "a.ply"}]}}, "occlusions, without which"),
        ({"vial": VIAL | {"occlusions": [{"filename": "a.ply", "bsdf": {"type": "dull"}}]}}, "a dielectric or one of"),
        ({"vial": VIAL | {"r_inn": 7}}, r"its key vial\.r_inn is unknown; did you mean r_int\?"),
        ({"vial": VIAL | {"medium": MEDIUM | {"absorption": 1}}}, r"medium\.absorption is unknown; expected one of"),
        ({"vial": VIAL | {"medium": {"ior": 1.4, "extinction": 1, "albedo": 0.5}}}, "0.5 without a phase"),
        ({"loss": {"type": "thresold"}}, "its loss is 'thresold'; expected threshold or l2"),
        ({"n_patterns": 24}, "its key n_patterns is unknown; expected it in projector: move it"),
        ({"filter_random": True}, r"its key filter_random is unknown; did you mean filter_radon\?"),
        ({"projector": {"type": "collimated", "n_patterns": 25, "pixel_size": 0.5}}, r"n_patterns 25, and .* 24"),
        ({"projector": {"type": "collimated", "resx": 25, "pixel_size": 0.5}}, r"resx 25, and 'patterns\.npz' 24"),
        ({"projector": {"type": "collimated"}}, "lacks 'pixel_size'"),
        ({"projector": {"type": "spot", "pixel_size": 0.1}}, "expected a collimated, telecentric or lens one"),
        ({"target": {}}, "lacks 'filename'"),
        ({"sensor": 3}, "sensor, which is not a table"),
        ({"vial": VIAL | {"r_ext": 0.1}}, "r_ext, which is 0.1; expected a number above"),
        ({"vial": VIAL | {"ior": None}}, "ior, which is None; expected a number from 1"),
        ({"vial": VIAL | {"medium": {"ior": 1.4, "extinction": -1}}}, "extinction, which is -1; expected a number"),
        ({"vial": VIAL | {"medium": {"ior": 1.4, "extinction": 1, "albedo": 2}}}, "expected a share from 0 to 1"),
        ({"projector": {"type": "collimated", "pixel_size": "0.1"}}, "pixel_size, which is '0.1'; expected a number"),
    ],
)  # fmt: skip
def test_a_set_up_without_a_model_is_refused(changes: dict[str, Any], said: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "patterns.npz", patterns=np.ones((24, 8, 24), np.float32))
    with pytest.raises(BadInput, match=said):
        import_patterns(configuration(tmp_path, **changes), tmp_path / "a.vam", device="cpu")
    assert not (tmp_path / "a.vam").exists()


def test_what_is_left_out_of_a_configuration_is_told_by_name(tmp_path: Path) -> None:
    more: dict[str, Any] = {
        "physical_model": {"type": "inhibitor"},
        "time": 30.0,
        "filter_radon": True,
        "_remark": "mine",
    }
    notes = import_task(configuration(tmp_path, **more), tmp_path / "box.toml")
    assert notes[1:] == (
        "its time is left out: it follows from irradiance and dose",
        "its filter_radon left out: `vam solve` has methods of its own",
    )


def test_occlusions_become_inserts_where_they_were_drawn(tmp_path: Path) -> None:
    rod = trimesh.creation.cylinder(0.6, 3.0)
    rod.apply_translation((2.0, 1.0, 0.5))
    rod.export(tmp_path / "rod.ply")
    glass = {"filename": "rod.ply", "bsdf": {"type": "dielectric", "int_ior": 1.58, "ext_ior": 1.4}}
    path = configuration(tmp_path, vial=VIAL | {"occlusions": [{"filename": "rod.ply"}, glass]})
    import_task(path, tmp_path / "box.toml")
    job = read_job(tmp_path / "box.toml")
    assert [(body.role, body.index) for body in job.file.body] == [("print", None), ("insert", None), ("insert", 1.58)]
    assert np.allclose(trimesh.load(tmp_path / "box-insert1.ply").bounds.mean(axis=0), (2.0, 1.0, 0.5), atol=0.01)
    operator = projection_of(job.file, target_of(job, vam.open_device("numpy")), vam.open_device("numpy"), tmp_path)

    assert "Traced" in type(operator).__name__


@pytest.mark.parametrize(("key", "value"), [("n_patterns", -3), ("n_patterns", 0), ("resx", 30.5), ("resy", "8")])
def test_wrong_numbers_of_a_task_are_named(key: str, value: Any, tmp_path: Path) -> None:
    path = configuration(tmp_path)
    said = json.loads(path.read_text())
    said["projector"] = {"n_patterns": 24, "resx": 24, "resy": 8} | said["projector"] | {key: value}
    path.write_text(json.dumps(said))
    with pytest.raises(BadInput, match=f"{key}, which is {value!r}; expected a"):
        import_task(path, tmp_path / "job.toml")


def test_what_is_no_configuration_at_all_is_told(tmp_path: Path) -> None:
    (tmp_path / "list.json").write_text("[1, 2]")
    with pytest.raises(BadInput, match=r"its outermost braces: it is a list, not a table; expected a configuration"):
        import_task(tmp_path / "list.json", tmp_path / "job.toml")


def test_what_is_no_json_is_told(tmp_path: Path) -> None:
    (tmp_path / "cut.json").write_text('{"vial":')
    with pytest.raises(StorageError, match=r"cannot read .*cut\.json': Expecting value.*; expected a configuration"):
        import_task(tmp_path / "cut.json", tmp_path / "job.toml")


@pytest.mark.parametrize("name", ["a.json", "a.mp4", "a.sino", "a"])
def test_a_source_that_does_not_exist_is_named(name: str, tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=rf"there is no '.*{name}'; check the path"):
        import_patterns(tmp_path / name, tmp_path / "b.vam", device="cpu")


def test_negative_light_is_not_called_dark(tmp_path: Path) -> None:
    light = np.random.default_rng(0).random((6, 5, 4)).astype(np.float32)
    np.save(tmp_path / "a.npy", -light)
    with pytest.raises(BadInput, match=r"reaches from -0\.\d+ to -0\.\d+; expected patterns, which are 0 or more"):
        read_vamtoolbox(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", light - 0.5)
    found = read_vamtoolbox(tmp_path / "b.npy")
    assert found.light.min() == 0.0 and any("below 0 count as dark" in note for note in found.notes)


def test_patterns_that_are_not_there_are_told(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"no patterns beside .*--patterns"):
        import_patterns(configuration(tmp_path), tmp_path / "a.vam")


def test_patterns_of_dr_tvam_are_read_as_images_too(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    from vamgpu.storage.images import write_exr

    patterns = np.random.default_rng(0).random((24, 8, 24)).astype(np.float32)
    (tmp_path / "patterns").mkdir()
    for index, pattern in enumerate(patterns):
        write_exr(tmp_path / "patterns" / f"{index:04d}.exr", pattern)
    np.savez(tmp_path / "other.npz", patterns=patterns)
    path = configuration(tmp_path)
    assert np.array_equal(read_drtvam(path).light, read_drtvam(path, tmp_path / "other.npz").light)


# ---- VAMToolbox -------------------------------------------------------------------------------------------------
class Pickled:
    """Stands for a class of VAMToolbox while it is pickled."""

    def __init__(self, **fields: Any) -> None:
        self.__dict__.update(fields)


@pytest.fixture
def toolbox(monkeypatch: pytest.MonkeyPatch) -> type[Pickled]:
    """The class under the name that VAMToolbox's pickles have."""
    module: Any = types.ModuleType("vamtoolbox.geometry")
    module.Sinogram = type("Sinogram", (Pickled,), {"__module__": "vamtoolbox.geometry"})
    monkeypatch.setitem(sys.modules, "vamtoolbox", types.ModuleType("vamtoolbox"))
    monkeypatch.setitem(sys.modules, "vamtoolbox.geometry", module)
    return module.Sinogram


def theirs(sinogram: np.ndarray, angles: np.ndarray, n: int) -> np.ndarray:
    """Its back projection of straight light, [y, x, z], about the middle."""
    places = np.arange(n) - 0.5 * (n - 1)
    y, x = np.meshgrid(places, places, indexing="ij")
    found = np.zeros((n, n, sinogram.shape[2]))
    for index, a in enumerate(np.radians(angles)):
        for z in range(sinogram.shape[2]):
            found[:, :, z] += np.interp(x * np.cos(a) - y * np.sin(a), places, sinogram[:, index, z], left=0, right=0)
    return found


def test_a_sinogram_of_vamtoolbox_gives_its_own_dose(toolbox: Any, tmp_path: Path) -> None:
    n, angles = 20, np.linspace(0.0, 360.0, 12, endpoint=False) + 7.0
    place, step = np.arange(n) - 0.5 * (n - 1), np.arange(12)
    light = np.exp(-(((place[:, None] - 4.0 * np.sin(step)) / 3.0) ** 2))[:, :, None] * [1.0, 0.5, 0.0, 2.0]
    geometry = toolbox(angles=angles, projector_pixel_size=0.05, absorption_coeff=None, index_model=None)
    (tmp_path / "a.sino").write_bytes(pickle.dumps(toolbox(array=light, proj_geo=geometry, vol_type="sino")))
    found = read_vamtoolbox(tmp_path / "a.sino")
    assert found.motion is not None and (np.diff(found.motion.poses) > 0).all()
    assert found.tables["beam"] == {"pitch": "0.5 mm"}
    A = vam.Projection(vam.Grid((n, n, 4), 0.5), vam.Beam((n, 4), 0.5, spread=0.0), found.motion, None, "numpy")
    ours = A.T(A.device.upload(found.light)).numpy().transpose(1, 0, 2)
    dose = theirs(light, angles, n)
    inside = np.hypot(*np.meshgrid(place, place)) < 8
    assert np.corrcoef(ours[inside].ravel(), dose[inside].ravel())[0, 1] > 0.999
    for wrong in (ours[::-1], ours.transpose(1, 0, 2), ours[:, :, ::-1]):
        assert np.corrcoef(wrong[inside].ravel(), dose[inside].ravel())[0, 1] < 0.97


def test_a_sinogram_and_its_voxels_become_a_job_that_proves(toolbox: Any, tmp_path: Path) -> None:
    part = np.zeros((16, 16, 4))
    part[4:9, 6:12] = 1.0
    np.save(tmp_path / "part.npy", part)
    target = vam.Target.from_array(part.transpose(1, 0, 2), 0.5)
    A = vam.Projection(target.grid, vam.Beam((18, 4), 0.5, spread=0.0), vam.Turntable(20, lit_share=0), None, "numpy")
    plan = vam.optimize(A, target, iterations=6)
    light = plan.sinogram.numpy()
    angles = np.mod(-np.degrees(A.motion.poses) - 90.0, 360.0)
    geometry = toolbox(angles=angles, projector_pixel_size=0.05)
    (tmp_path / "a.sino").write_bytes(pickle.dumps(toolbox(array=light.transpose(1, 0, 2), proj_geo=geometry), 5))
    import_patterns(tmp_path / "a.sino", tmp_path / "a.vam", target=tmp_path / "part.npy", device="cpu",
                    settings=["beam.spread=0 mm"])  # fmt: skip
    found = prove(tmp_path / "a.vam", "cpu").proof.scores
    assert STEPPED in Folder.open(tmp_path / "a.vam").manifest.inputs["imported"]["notes"]
    own = vam.simulate(A, vam.pack(plan, quantile=1.0), target).scores
    assert own.iou > 0.9 and (found.iou, found.missing) == pytest.approx((own.iou, own.missing))
    assert found.window == pytest.approx(own.window, abs=2e-3)


def test_a_preset_of_vamtoolbox_becomes_a_job(tmp_path: Path) -> None:
    trimesh.creation.box((2, 3, 4)).export(tmp_path / "box.stl")
    said: dict[str, Any] = {"stl_path": "box.stl", "part_height_mm": 12.0, "voxel_pitch_um": 100.0, "n_angles": 90,
                            "vial_radius_mm": 10.0, "proj_u_px": 200, "proj_v_px": 150, "mm_per_pix": 0.1,
                            "diffusion": True, "method": "BCLP", "throw_ratio": float("inf")}  # fmt: skip
    (tmp_path / "preset.json").write_text(json.dumps(said))
    notes = import_task(tmp_path / "preset.json", tmp_path / "job.toml")
    assert notes == ("its method left out: `vam solve` has methods of its own",)
    job = read_job(tmp_path / "job.toml")
    part = target_of(job, vam.open_device("numpy"))
    assert part.height == pytest.approx(12.0) and part.grid.pitch == 0.1
    vial: Any = job.file.vial
    assert (vial.radius, vial.inner_radius, vial.resin_index, vial.bath_index) == (10.0, 10.0, 1.51, 1.0)
    assert vial.absorption == pytest.approx(36.0 * 4e-3 * np.log(10.0) / 10.0)
    assert (job.file.beam.pixels, job.file.beam.pitch, job.file.turntable.angles) == ((200, 150), 0.1, 90)
    diffusion = job.file.resin.diffusion
    assert diffusion is not None and (diffusion.diffusivity, diffusion.seconds) == (1e-4, 10.0)
    more = {"throw_ratio": 2.0, "absorption_coeff_cm": 0.5, "diffusion": False, "voxel_pitch_um": 72.0}
    (tmp_path / "preset.json").write_text(json.dumps(said | more))
    import_task(tmp_path / "preset.json", tmp_path / "job.toml", overwrite=True)
    assert 'pitch = "0.072 mm"' in (tmp_path / "job.toml").read_text()
    vessel: Any = read_job(tmp_path / "job.toml").file.vessel
    assert vessel.throw == pytest.approx(2.0 * 200 * 0.1) and vessel.inner.absorption == pytest.approx(0.05)
    for wrong, words in (({"part_heigt_mm": 1}, "did you mean part_height_mm"), ({"stl_path": None}, "has no stl_path"),
                         ({"n_angles": "9"}, "n_angles, which is '9'")):  # fmt: skip
        (tmp_path / "preset.json").write_text(json.dumps(said | wrong))
        with pytest.raises(BadInput, match=words):
            import_task(tmp_path / "preset.json", tmp_path / "job.toml", overwrite=True)
    with pytest.raises(BadInput, match="preset of VAMToolbox, which has no patterns; make a job of it with --out"):
        read_drtvam(tmp_path / "preset.json")


def test_a_sinogram_of_other_angles_than_the_job_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((16, 60, 4), np.float32))
    with pytest.raises(BadInput, match="patterns for 60 angles, but the job has 90; expected the same number"):
        import_patterns(tmp_path / "a.npy", tmp_path / "a.vam", settings=["turntable.angles=90", "target.shape=boat",
                        "target.height=3 mm", "target.pitch=0.5 mm", "beam.pitch=0.5 mm"])  # fmt: skip


def test_roles_of_voxels_that_are_left_out_are_told(toolbox: Any, tmp_path: Path) -> None:
    part = np.zeros((16, 16, 4))
    part[4:9, 6:12] = 1.0
    target = toolbox(array=part, insert=part[::-1] > 0, zero_dose=None)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(target))
    np.save(tmp_path / "a.npy", np.ones((16, 6, 4), np.float32))
    notes = read_vamtoolbox(tmp_path / "a.npy", tmp_path / "a.pkl").notes
    assert "the insert voxels of its target are left out; describe them as [[body]] in a job" in notes


class Harm:
    """Would make a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self.path}",)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_nothing_in_a_pickle_is_run(protocol: int, toolbox: Any, tmp_path: Path) -> None:
    file = tmp_path / "a.sino"
    array = np.arange(24.0).reshape(3, 2, 4).transpose(1, 0, 2)
    sound = toolbox(array=array, proj_geo=toolbox(angles=np.arange(3.0)), other=np.asfortranarray(array[0], ">f4"))
    file.write_bytes(pickle.dumps(sound, protocol))
    held = read_pickle(file, ("vamtoolbox",))
    assert np.array_equal(held.array, array) and np.array_equal(held.other, array[0]) and held.name == "Sinogram"
    assert read_vamtoolbox(file).light.shape == (3, 2, 4)
    sound.extra = Harm(tmp_path / "harm")
    file.write_bytes(pickle.dumps(sound, protocol))
    with pytest.raises(StorageError, match=r"would call posix\.system\); nothing of it was run"):
        read_vamtoolbox(file)
    assert not (tmp_path / "harm").exists()


# ---- images and films -------------------------------------------------------------------------------------------
JOB = """
[target]
shape = "boat"
height = "6 mm"
pitch = "1 mm"
[beam]
pitch = "1 mm"
"""


def shown(tmp_path: Path, **options: Any) -> tuple[Any, Any]:
    """Frames of a boat, and the light that they have."""
    job = tmp_path / "boat.toml"
    job.write_text(JOB, encoding="utf-8")
    target = vam.Target.from_mesh(shapes.build("boat"), height=6.0, pitch=1.0)
    A = vam.Projection(target.grid, vam.Beam((14, 10), 1.0), vam.Turntable(16))
    frames = vam.pack(vam.optimize(A, target, iterations=3), **options)
    return frames, frames.irradiance().numpy() / frames.scale


@pytest.mark.parametrize(("name", "bits"), [("png", 8), ("film.mp4", 1)])
def test_what_was_exported_comes_back(name: str, bits: int, tmp_path: Path) -> None:
    frames, light = shown(tmp_path, bits=bits, gray=GrayCurve.gamma(2.0), flip_r=True, shift=(1.0, 0.0))
    export(frames, tmp_path / name)
    found = read_pictures(tmp_path / name, Layout())
    assert found.full == pytest.approx(frames.scale) and found.motion == vam.Turntable(16)
    assert np.allclose(found.light / frames.scale, light, atol=1e-6)
    import_patterns(tmp_path / name, tmp_path / "a.vam", job=tmp_path / "boat.toml", device="cpu")
    assert prove(tmp_path / "a.vam", "cpu").proof.scores.iou > 0.2


@pytest.mark.parametrize("flip_r", [False, True])
@pytest.mark.parametrize("flip_z", [False, True])
def test_images_without_a_word_lie_as_they_are_said_to(flip_r: bool, flip_z: bool, tmp_path: Path) -> None:
    from PIL import Image

    frames, light = shown(tmp_path)
    levels = np.zeros((16, 30, 40), np.uint8)
    images = frames.levels()[:, :, ::-1] if flip_r else frames.levels()
    levels[:, 6:16, 12:26] = images[:, ::-1] if flip_z else images
    (tmp_path / "stack").mkdir()
    for index, image in enumerate(levels[::-1] if flip_z else levels):
        Image.fromarray(image).save(tmp_path / "stack" / f"image{index}.png")
    layout = Layout(flip_r, flip_z, reverse=flip_z, axis=18.5, level=10.5)
    found = read_pictures(tmp_path / "stack", layout).light
    expected = np.roll(light, 1, axis=0) if flip_z else light
    trim = [(light.shape[axis] - found.shape[axis]) // 2 for axis in (1, 2)]
    assert np.allclose(found, expected[:, trim[0] : 14 - trim[0], trim[1] : 10 - trim[1]], atol=1e-6)
    assert expected.sum() == pytest.approx(found.sum(), rel=1e-5)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("f1.png", "f2.png", "f4.png"), r"between 'f2\.png' and 'f4\.png' the numbers go from 2 to 4"),
        (("f1.png", "f01.png", "f2.png"), "the numbers go from 1 to 1"),
        (("f1.png", "logo.png", "f2.png"), r"'logo\.png' is named otherwise than the 2 images f#\.png"),
        (("a.jpg", "b.jpg"), "no images besides JPG, which loses gray levels"),
        (("manifest.json",), "is a job folder already; .* vam prove "),
        (("9.png", "10.png", "11.png"), ""),
        (("a-0.png", "a-5.png", "a-10.png"), ""),
        (("left.png", "right.png"), ""),
    ],
)
def test_a_folder_whose_images_do_not_follow_each_other_is_refused(
    names: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    for name in names:
        (tmp_path / name).write_bytes(encode_png(np.full((2, 2), 255, np.uint8)))
    if not said:
        assert read_pictures(tmp_path, Layout()).light.shape[0] == len(names)
        return
    with pytest.raises(BadInput, match=said):
        read_pictures(tmp_path, Layout())


def test_images_with_colors_or_of_other_formats_are_refused(tmp_path: Path) -> None:
    (tmp_path / "f1.png").write_bytes(encode_png(np.full((2, 2, 3), 200, np.uint8)))
    (tmp_path / "f2.png").write_bytes(encode_png(np.full((2, 2), 200, np.uint8)))
    assert np.allclose(read_pictures(tmp_path, Layout()).light, 200 / 255)  # gray in three channels
    (tmp_path / "f2.png").write_bytes(encode_png(np.array([[[200, 200, 199]] * 2] * 2, np.uint8)))
    with pytest.raises(StorageError, match=r"f2\.png': it has colors"):
        read_pictures(tmp_path, Layout())
    (tmp_path / "f2.png").write_text("text")
    with pytest.raises(StorageError, match=r"f2\.png': it is none of PNG, TIFF"):
        read_pictures(tmp_path, Layout())
    (tmp_path / "f2.png").unlink()
    for layout, wrong in ((Layout(level=0.3), "--level is 0.3, and the images have 2 rows"),
                          (Layout(angles=0), "--angles is 0, but .* has 1 image; expected")):  # fmt: skip
        with pytest.raises(BadInput, match=wrong):
            read_pictures(tmp_path, layout)


def test_a_job_says_what_images_do_not(tmp_path: Path) -> None:
    frames, _ = shown(tmp_path)
    place = export(frames, tmp_path / "png")
    (place / "frames.json").unlink()
    with pytest.raises(JobError, match="target"):
        import_patterns(place, tmp_path / "a.vam", device="cpu")
    job = tmp_path / "boat.toml"
    sinogram = tmp_path / "own.npy"
    np.save(sinogram, np.ones((24, 16, 8), np.float32))  # VAMToolbox's axes are r, angle, z
    with pytest.raises(BadInput, match=r"patterns for 16 angles, but the job has 99; expected the same number"):
        import_patterns(sinogram, tmp_path / "a.vam", job=job, settings=["turntable.angles=99"], device="cpu")
    with pytest.raises(JobError, match=r"(?s)own.npy' lacks keys of a job; .*: --job job.toml\n.*target is missing"):
        import_patterns(sinogram, tmp_path / "a.vam", device="cpu")
    assert not (tmp_path / "a.vam").exists()
    with pytest.raises(BadInput, match="patterns for 16 angles, but the job has 99"):
        import_patterns(place, tmp_path / "a.vam", job=job, settings=["turntable.angles=99"], device="cpu")
    with pytest.raises(BadInput, match="leave beam.pixels out"):
        import_patterns(place, tmp_path / "a.vam", job=job, settings=["beam.pixels=[3, 4]"], device="cpu")
    with pytest.raises(BadInput, match="--axis is 99, and the images have 14 columns; expected 0 to 13, in"):
        import_patterns(place, tmp_path / "a.vam", job=job, layout=Layout(axis=99.0), device="cpu")
    with pytest.raises(BadInput, match="cannot import"):
        import_patterns(job, tmp_path / "a.vam", device="cpu")


def test_a_job_goes_to_dr_tvam_and_back(tmp_path: Path) -> None:
    target = vam.Target.from_mesh(shapes.build("boat"), height=6.0, pitch=1.0, shape=(14, 15, 9))
    vial = vam.Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.47, bath_index=1.0, absorption=0.05)
    A = vam.Projection(target.grid, vam.Beam((18, 10), 1.0, spread=0.0), vam.Turntable(12), vial, "numpy")
    plan = vam.optimize(A, target, iterations=2)
    frames = vam.pack(plan)
    export_drtvam(frames, tmp_path / "theirs")
    found = read_drtvam(tmp_path / "theirs" / "config.json")
    assert np.allclose(found.light, plan.sinogram.numpy(), rtol=1e-6)
    import_patterns(tmp_path / "theirs" / "config.json", tmp_path / "back.vam", device="cpu")
    back: Any = vam.load(tmp_path / "back.vam", "cpu")
    assert back.plan.operator.vessel == vial and back.plan.operator.beam == A.beam
    assert back.plan.operator.grid == A.grid
    assert back.plan.target.volume == pytest.approx(target.volume, rel=0.02)
    square = vam.Projection(target.grid, A.beam, vam.Turntable([0.0, 0.1]), None, "numpy")
    with pytest.raises(BadInput, match="expected equal steps"):
        export_drtvam(vam.pack(vam.optimize(square, target, iterations=1)), tmp_path / "b")
    with pytest.raises(BadInput, match="got frames without a plan"):
        export_drtvam(replace(frames, packed=None), tmp_path / "b")
