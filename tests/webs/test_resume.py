"""Webs whose process is killed, resumed, and compared with one that was left alone."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from full_disk import files_of_at_most
from slanted import WINDOW, part, stream, tiled

from vamgpu.errors import StorageError
from vamgpu.webs.store import RECORD, WebFolder

PROGRAM = """
import sys
sys.path.insert(0, sys.argv[2])
from slanted import WINDOW, part, stream, tiled
job = stream(tiled(part(16 * WINDOW)), core=1.0, iterations=4)
job.write(sys.argv[1], progress=lambda done, of: print("done", flush=True))
"""


def contents(folder: WebFolder) -> dict[str, bytes]:
    """Every file of a web by its name, the record included."""
    files = (*folder.files(), folder.path / RECORD)
    return {str(file.relative_to(folder.path)): file.read_bytes() for file in files}


def killed(place: Path, segments: int, after: float) -> bool:
    """Write until done or killed, which comes ``after`` seconds behind that many segments; whether it was killed."""
    command = [sys.executable, "-c", PROGRAM, str(place), str(Path(__file__).parent)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        for _ in range(segments):
            process.stdout.readline()
        time.sleep(after)
        process.send_signal(signal.SIGKILL)
        return process.wait() == -signal.SIGKILL


@pytest.mark.slow
def test_a_web_killed_at_any_moment_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    job = stream(tiled(part(16 * WINDOW)), core=1.0, iterations=4)
    began = time.perf_counter()
    alone = job.write(tmp_path / "alone.vam")
    whole = time.perf_counter() - began
    assert len(alone.segments) == 17
    place, chance, found = tmp_path / "killed.vam", random.Random(7), [0]
    for _ in range(5):
        going = killed(place, chance.randint(1, 2), chance.uniform(0.0, 2.0) * whole / len(alone.segments))
        kept = WebFolder.open(place)
        kept.verify()
        found.append(len(kept.segments))
        if not going or kept.complete:
            break
    again = stream(tiled(part(16 * WINDOW)), core=1.0, iterations=4).write(place)
    assert found == sorted(set(found))  # each run goes on where the one before it was stopped
    assert contents(again) == contents(alone)


def interrupted(place: Path, segments: int) -> WebFolder:
    """A web that stopped after some segments."""

    class Stop(Exception):
        pass

    def stop(done: int, of: int | None) -> None:
        if done == segments:
            raise Stop

    with pytest.raises(Stop):
        stream(tiled(part(8 * WINDOW)), core=1.0).write(place, progress=stop)
    return WebFolder.open(place)


@pytest.mark.slow
def test_a_full_disk_loses_no_segment_that_was_counted(tmp_path: Path) -> None:
    job = stream(tiled(part(6 * WINDOW)), core=1.0, iterations=2)
    alone, place, limits = job.write(tmp_path / "alone.vam"), tmp_path / "web.vam", ExitStack()

    def fill(done: int, _: int | None) -> None:
        if done == 3:
            limits.enter_context(files_of_at_most(200))

    with pytest.raises(StorageError, match="beyond what the system allows"), limits:
        job.write(place, progress=fill)
    kept = WebFolder.open(place)
    assert len(kept.segments) == 3
    kept.verify()
    assert contents(job.write(place)) == contents(alone)


def test_frames_half_written_are_never_counted(tmp_path: Path) -> None:
    """What a run leaves that dies after it wrote frames, and before it counted them."""
    alone = stream(tiled(part(8 * WINDOW)), core=1.0).write(tmp_path / "alone.vam")
    folder = interrupted(tmp_path / "web.vam", 4)
    rubbish = np.full((WINDOW, *folder.frame(0).shape), 77, np.uint8)
    folder.append(rubbish, np.zeros((0, 6, 4), np.uint8), (0.0, 0.0), 0, False)
    folder._save()  # the count of four again
    (folder.path / "frames" / "c" / "5").mkdir()
    (folder.path / "frames" / "c" / "5" / "0.partial").write_bytes(b"half")
    (folder.path / (RECORD + ".partial")).write_text("{")
    reread = WebFolder.open(folder.path)
    reread.verify()
    assert reread.frames == 4 * WINDOW
    with pytest.raises(ValueError, match="expected 0 to 96"):
        reread.read("frames", 4 * WINDOW, 5 * WINDOW)
    again = stream(tiled(part(8 * WINDOW)), core=1.0).write(folder.path)
    assert contents(again) == contents(alone)
    assert not list(folder.path.rglob("*.partial"))


def test_damage_is_found(tmp_path: Path) -> None:
    folder = interrupted(tmp_path / "web.vam", 3)
    file = next(file for file in folder.files() if "frames/c/1/" in file.as_posix())
    spoiled = bytearray(file.read_bytes())
    spoiled[10] ^= 0xFF
    file.write_bytes(bytes(spoiled))
    with pytest.raises(StorageError):
        folder.verify()
    file.unlink()
    with pytest.raises(StorageError, match="missing"):
        folder.verify()
    (folder.path / RECORD).write_text(json.dumps({"format": "other"}))
    with pytest.raises(StorageError, match="not a record of a web"):
        WebFolder.open(folder.path)
    with pytest.raises(StorageError, match="no web"):
        WebFolder.open(tmp_path)


def test_one_frame_is_one_chunk(tmp_path: Path) -> None:
    import zarr

    folder = interrupted(tmp_path / "web.vam", 2)
    frames = zarr.open_array(folder.path / "frames", mode="r")
    assert frames.chunks == (1, *folder.frame(0).shape)
    assert frames.shards is not None and frames.shards[0] == WINDOW
    assert os.path.getsize(folder.path / "frames" / "c" / "0" / "0" / "0") > 0
    assert np.array_equal(np.asarray(frames[WINDOW + 3]), folder.frame(WINDOW + 3))
