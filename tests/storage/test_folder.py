"""Job folders: whole or not at all, readable, and honest about damage."""

from __future__ import annotations

import hashlib
import json
import os
import random
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from full_disk import files_of_at_most

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError
from vamgpu.storage import folder as module
from vamgpu.storage.arrays import create, shard_length
from vamgpu.storage.atomic import clear
from vamgpu.storage.folder import Entry, Folder, write_folder
from vamgpu.storage.shards import LEVEL

FRAMES = np.random.default_rng(0).integers(0, 256, (7, 30, 40), np.uint8)


def write(path: Path, values: np.ndarray = FRAMES, **more: object) -> Folder:
    options = {"inputs": {"part": "boat"}, "details": {}, "device": "numpy"} | more
    return write_folder(path, {"frames": Entry(values, ("angle", "row", "column"))}, **options)  # type: ignore[arg-type]


def chunk_files(job: Path) -> list[Path]:
    return sorted(path for path in (job / "frames" / "c").rglob("*") if path.is_file())


def test_arrays_come_back_whole_and_one_by_one(tmp_path: Path) -> None:
    write(tmp_path / "a.vam")
    job = Folder.open(tmp_path / "a.vam")
    assert np.array_equal(job.array("frames"), FRAMES)
    assert np.array_equal(job.one("frames", 6), FRAMES[6])
    job.verify()
    assert [path.name for path in tmp_path.iterdir()] == ["a.vam"]


def test_arrays_come_from_devices(device: Device, tmp_path: Path) -> None:
    light = np.random.default_rng(1).random((4, 5, 19)).astype(np.float32)
    entry = Entry(device.upload(light), ("angle", "r", "z"), "mW/mm²")
    job = write_folder(tmp_path / "a.vam", {"light": entry}, inputs={}, details={}, device=device.name)
    assert np.array_equal(job.array("light"), light)
    assert job.record("light").unit == "mW/mm²" and job.record("light").axes == ("angle", "r", "z")


@pytest.mark.parametrize("kind", ["uint8", "float32", "bool"])
def test_a_header_is_that_which_zarr_writes(tmp_path: Path, kind: str) -> None:
    import zarr
    from zarr.codecs import ZstdCodec

    shape, shards, axes = (700, 3, 4), (512, 3, 4), ("angle", "row", "column")
    (tmp_path / "own").mkdir()
    create(tmp_path / "own", "frames", shape, np.dtype(kind), shards, axes)
    zarr.open_group(tmp_path / "theirs", mode="a", zarr_format=3).create_array(
        "frames", shape=shape, dtype=kind, chunks=(1, 3, 4), shards=shards, dimension_names=axes,
        compressors=ZstdCodec(level=LEVEL, checksum=True),
    )  # fmt: skip
    for header in ("zarr.json", "frames/zarr.json"):
        own, theirs = (json.loads((tmp_path / by / header).read_text("utf-8")) for by in ("own", "theirs"))
        assert own == theirs


def test_frames_are_chunks_and_files_hold_many(tmp_path: Path) -> None:
    import zarr

    write(tmp_path / "a.vam", np.zeros((700, 3, 4), np.uint8))
    array = zarr.open_array(tmp_path / "a.vam" / "frames", mode="r")
    assert array.chunks == (1, 3, 4) and array.shards == (512, 3, 4)
    assert array.metadata.zarr_format == 3
    assert len(chunk_files(tmp_path / "a.vam")) == 2
    assert shard_length((4000, 1080, 1920), 1) == 32


@dataclass(frozen=True)
class Nested:
    grid: vam.Grid
    source: Path


def test_the_manifest_is_for_reading(tmp_path: Path) -> None:
    inputs = {"nested": Nested(vam.Grid((3, 4, 5), 0.1), Path("boat.stl")), "weights": np.array([1.0, 2.5])}
    write(tmp_path / "a.vam", inputs=inputs, details={"frames": {"bits": 8}}, device="warp:cpu")
    text = (tmp_path / "a.vam" / "manifest.json").read_text(encoding="utf-8")
    data = json.loads(text)
    assert data["inputs"] == {
        "nested": {"grid": {"shape": [3, 4, 5], "pitch": 0.1}, "source": "boat.stl"},
        "weights": [1.0, 2.5],
    }
    assert data["device"] == "warp:cpu" and data["details"]["frames"]["bits"] == 8
    assert data["versions"]["vamgpu"] == vam.__version__ and "zarr" in data["versions"]
    assert data["units"]["length"] == "mm" and data["units"]["dose"] == "mJ/mm³"
    assert data["arrays"]["frames"]["sha256"] == hashlib.sha256(FRAMES.tobytes()).hexdigest()
    assert '"shape": [7, 30, 40]' in text
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".pkl", ".pickle", ".npy")]


@pytest.mark.parametrize("value", [float("nan"), object(), {"deep": [1, {2}]}, vam.Grid])
def test_inputs_that_json_cannot_hold_are_refused(tmp_path: Path, value: object) -> None:
    with pytest.raises(BadInput, match="inputs.odd"):
        write(tmp_path / "a.vam", inputs={"odd": value})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "values", "axes"),
    [
        ("../up", FRAMES, ("a", "b", "c")),
        ("frames", FRAMES, ("a", "b")),
        ("frames", np.zeros((0, 2)), ("a", "b")),
        ("frames", np.array([object()]), ("a",)),
    ],
)
def test_odd_arrays_are_refused(tmp_path: Path, name: str, values: np.ndarray, axes: tuple[str, ...]) -> None:
    with pytest.raises(BadInput, match="plain name"):
        write_folder(tmp_path / "a.vam", {name: Entry(values, axes)}, inputs={}, details={}, device="numpy")
    assert not list(tmp_path.iterdir())


def test_a_job_is_not_overwritten_unless_asked(tmp_path: Path) -> None:
    write(tmp_path / "a.vam")
    with pytest.raises(StorageError, match="exists"):
        write(tmp_path / "a.vam", FRAMES + 1)
    assert np.array_equal(Folder.open(tmp_path / "a.vam").array("frames"), FRAMES)
    write(tmp_path / "a.vam", FRAMES + 1, overwrite=True)
    assert np.array_equal(Folder.open(tmp_path / "a.vam").array("frames"), FRAMES + 1)
    precious = tmp_path / "precious"
    precious.mkdir()
    with pytest.raises(StorageError, match="not a job folder"):
        write(precious, overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.vam", "precious"]


def test_a_full_disk_leaves_nothing_behind_and_the_old_job_alone(tmp_path: Path) -> None:
    write(tmp_path / "old.vam")
    big = np.random.default_rng(2).integers(0, 256, (2, 1000, 1000), np.uint8)
    for place, overwrite in (("new.vam", False), ("old.vam", True)):
        with files_of_at_most(500_000), pytest.raises(StorageError, match="beyond what the system allows"):
            write(tmp_path / place, big, overwrite=overwrite)
    assert [path.name for path in tmp_path.iterdir()] == ["old.vam"]
    Folder.open(tmp_path / "old.vam").verify()


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, RuntimeError])
def test_an_interrupted_write_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    def stop(*_: object) -> None:
        raise error

    monkeypatch.setattr(module, "describe", stop)  # by then the frames are written, the manifest is not
    with pytest.raises(error):
        write(tmp_path / "a.vam")
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StorageError, match="file"):
        write(tmp_path / "file" / "a.vam")


def test_what_is_no_job_is_named(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="not a finished job"):
        Folder.open(tmp_path / "nowhere.vam")
    write(tmp_path / "a.vam")
    with pytest.raises(StorageError, match="it has frames"):
        Folder.open(tmp_path / "a.vam").array("dose")
    with pytest.raises(BadInput, match="0 to 6"):
        Folder.open(tmp_path / "a.vam").one("frames", 7)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"format": "vamgpu job"', '"format": "cake"', "not a manifest"),
        ('"version": 2', '"version": 99', "reads 1 to 2"),
        ('"sha256"', '"md5"', "sha256"),
        ('"inputs"', '"outputs"', "inputs"),
        ("{", "", "not valid JSON"),
    ],
)
def test_damaged_manifests_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    write(tmp_path / "a.vam")
    file = tmp_path / "a.vam" / "manifest.json"
    file.write_text(file.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(StorageError, match=says):
        Folder.open(tmp_path / "a.vam")


def test_damaged_bytes_are_found(tmp_path: Path) -> None:
    job = write(tmp_path / "a.vam")
    file = chunk_files(tmp_path / "a.vam")[0]
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(StorageError, match="damaged"):
        job.array("frames")
    file.write_bytes(content[: len(content) // 3])
    with pytest.raises(StorageError, match="damaged"):
        job.one("frames", 6)


def test_missing_files_are_not_read_as_darkness(tmp_path: Path) -> None:
    job = write(tmp_path / "a.vam")
    chunk_files(tmp_path / "a.vam")[0].unlink()
    for read in (lambda: job.array("frames"), lambda: job.one("frames", 0)):
        with pytest.raises(StorageError, match="0 of 1 files"):
            read()


def test_changed_bytes_are_found_even_where_they_are_well_formed(tmp_path: Path) -> None:
    import zarr

    job = write(tmp_path / "a.vam")
    zarr.open_array(tmp_path / "a.vam" / "frames", mode="r+")[3, 4, 5] = FRAMES[3, 4, 5] ^ 1
    with pytest.raises(StorageError, match="SHA-256"):
        job.array("frames")


def test_arrays_of_another_shape_are_found(tmp_path: Path) -> None:
    job, other = write(tmp_path / "a.vam"), write(tmp_path / "b.vam", FRAMES[:, :20])
    (job.path / "frames").rename(tmp_path / "aside")
    (other.path / "frames").rename(job.path / "frames")
    with pytest.raises(StorageError, match="its manifest says uint8"):
        job.array("frames")


def test_all_of_a_job_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A power cut loses what was not brought to the disk, names of files among it."""
    settled, moved = set[int](), list[set[int]]()
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda handle: settled.add(os.fstat(handle).st_ino) or fsync(handle))
    monkeypatch.setattr(os, "replace", lambda *names: moved.append(set(settled)) or replace(*names))
    job = write(tmp_path / "a.vam", np.zeros((700, 3, 4), np.uint8)).path
    every = [path for path in job.rglob("*") if path.name != "zarr.json" or path.parent != job]
    assert len(every) > 8
    assert {path.stat().st_ino for path in every} <= moved[-1]
    assert {job.stat().st_ino, tmp_path.stat().st_ino} <= settled


@pytest.mark.slow
def test_a_writer_killed_at_any_moment_loses_nothing_it_confirmed(tmp_path: Path) -> None:
    """It writes jobs over one another, and tells when each is there."""
    program = (
        "import sys, numpy as np; from pathlib import Path; from vamgpu.storage.folder import Entry, write_folder\n"
        "for k in range(10**6):\n"
        "    values = Entry(np.full((40, 200, 200), k, np.int32), ('a', 'b', 'c'))\n"
        "    write_folder(Path(sys.argv[1]), {'x': values}, inputs={}, details={}, device='', overwrite=True)\n"
        "    print(k, flush=True)\n"
    )
    chance, place = random.Random(3), tmp_path / "job.vam"
    for _ in range(12):
        with subprocess.Popen([sys.executable, "-c", program, str(place)], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            lines = [process.stdout.readline() for _ in range(chance.randint(1, 4))]
            time.sleep(chance.uniform(0.0, 0.1))
            process.kill()
            told = int([*lines, *process.stdout.read().splitlines()][-1])
        clear(place)
        found = np.unique(Folder.open(place).array("x"))
        assert len(found) == 1 and found[0] >= told
        assert [path.name for path in tmp_path.iterdir()] == ["job.vam"]
