"""Writing stacks of slices: same names, whole or not at all, never over the originals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from vamgpu.curethrough.images import encode
from vamgpu.curethrough.names import following
from vamgpu.curethrough.output import RECORD, check_place, writing
from vamgpu.curethrough.stack import open_stack
from vamgpu.errors import StorageError


def levels(slices: int = 40, rows: int = 6, columns: int = 7) -> np.ndarray:
    return np.random.default_rng(5).integers(0, 256, (slices, rows, columns), dtype=np.uint8)


def sources(tmp_path: Path, stack: np.ndarray) -> list[Path]:
    """The same slices as a folder of TIFF, a zip and an SL1."""
    folder = tmp_path / "tiffs"
    folder.mkdir()
    for k, picture in enumerate(stack):
        (folder / f"s{k}.tif").write_bytes(encode(picture, ".tif"))
    for name, extra in (("in.zip", {}), ("in.sl1", {"config.ini": b"jobDir = x\nnumFast = 40\nlayerHeight = 0.05\n"})):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            for k, picture in enumerate(stack):
                archive.writestr(f"s{k:05d}.png", encode(picture, ".png"))
            for key, data in extra.items():
                archive.writestr(key, data)
    return [folder, tmp_path / "in.zip", tmp_path / "in.sl1"]


def test_slices_keep_their_names_and_the_tail_counts_on(tmp_path: Path) -> None:
    wanted = levels()
    longer = np.concatenate([wanted, levels(3)])
    for place in sources(tmp_path, wanted):
        out = tmp_path / ("out" + place.suffix)
        with open_stack(place) as stack:
            names = stack.names + following(stack.names[-1], 3, stack.names)
            with writing(out, names, source=stack, record={"speed": 1.5}) as writer:
                for start, stop in ((32, 43), (0, 32)):
                    writer.write(start, longer[start:stop])
        with open_stack(out) as back:
            assert back.names == names
            np.testing.assert_array_equal(back[0:43], longer)
        if out.suffix == ".sl1":
            with zipfile.ZipFile(out) as archive:
                assert b"numFast = 43\nlayerHeight" in archive.read("config.ini")
        elif out.is_dir():
            assert json.loads((out / RECORD).read_text()) == {"speed": 1.5}
        if out.suffix:
            with zipfile.ZipFile(out) as archive:
                pictures = [name for name in archive.namelist() if name.endswith(".png")]
            assert pictures == list(names), "archives list slices in their order"


def test_originals_are_never_overwritten(tmp_path: Path) -> None:
    wanted = levels()
    for place in sources(tmp_path, wanted):
        before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
        link = tmp_path / ("link" + place.suffix)
        link.symlink_to(place)
        within = [place / "corrected"] if place.is_dir() else []
        with open_stack(place) as stack:
            for bad in (place, link, tmp_path, *within):
                with pytest.raises(StorageError, match="would overwrite the originals"):
                    check_place(bad, stack, overwrite=True)
                with pytest.raises(StorageError), writing(bad, stack.names, source=stack, overwrite=True):
                    raise AssertionError("never reached")
        link.unlink()
        assert before == {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}


def test_only_what_was_written_here_is_replaced(tmp_path: Path) -> None:
    names = ("a1.png",)
    for _ in range(2):
        with writing(tmp_path / "out", names, overwrite=True) as writer:
            writer.write(0, levels(1))
    with pytest.raises(StorageError, match="exists; choose another path, or allow"):
        check_place(tmp_path / "out")
    (tmp_path / "precious").mkdir()
    with pytest.raises(StorageError, match="holds no corrected slices"):
        check_place(tmp_path / "precious", overwrite=True)
    with pytest.raises(StorageError, match="lack the printer settings of an SL1"):
        check_place(tmp_path / "new.sl1")


@pytest.mark.parametrize("name", ["out", "out.zip"])
def test_an_exception_leaves_nothing(tmp_path: Path, name: str) -> None:
    with pytest.raises(KeyboardInterrupt), writing(tmp_path / name, ("a1.png", "a2.png")) as writer:
        writer.write(0, levels(2))
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


KILLED = """
import sys, time
import numpy as np
from vamgpu.curethrough.output import writing
with writing(sys.argv[1], tuple(f"s{k:04d}.png" for k in range(400))) as writer:
    for start in range(0, 400, 20):
        writer.write(start, np.random.default_rng(0).integers(0, 256, (20, 300, 300), dtype=np.uint8))
        print(start, flush=True)
    time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["out", "out.zip"])
def test_a_killed_run_leaves_no_slice_under_a_final_name(tmp_path: Path, name: str) -> None:
    run = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / name)], stdout=subprocess.PIPE, text=True)
    assert run.stdout is not None
    while run.stdout.readline().strip() != "200":
        assert run.poll() is None
    time.sleep(0.01)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    run.stdout.close()
    assert not (tmp_path / name).exists()
    assert all(path.name.startswith(f".{name}.partial-") for path in tmp_path.iterdir())


def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(StorageError, match="the disk is full"), writing(tmp_path / "out", ("a1.png",)) as writer:
        writer.write(0, levels(1))
    assert list(tmp_path.iterdir()) == []
