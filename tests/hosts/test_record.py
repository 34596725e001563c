"""A run's folder is complete up to the last frame, whatever ends the run."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

from vamgpu.errors import StorageError
from vamgpu.hosts.records.account import account
from vamgpu.hosts.records.record import MAGIC, FrameRecord, RunFolder, read_run, timing
from vamgpu.hosts.records.state import PrintState, PrintStates, StateChange

RIG = 'name = "lab"\n'


def test_what_is_written_is_read(tmp_path: Path) -> None:
    states = PrintStates()
    with RunFolder.begin(tmp_path / "run", {"job": "boat"}, RIG) as folder:
        states.listen(folder.state)
        states.to(PrintState.PRINTING)
        folder.event("light", 5, on=True)
        for number in range(100):
            folder.shown(FrameRecord(number, number % 7, -number, 10 * number, 4, late=1000 * number, engine=1))
        states.to(PrintState.COMPLETE, "done")
    run = read_run(tmp_path / "run")
    assert (run.asked, run.state, run.message, run.torn) == ({"job": "boat"}, PrintState.COMPLETE, "done", 0)
    assert run.shown["position"].tolist() == [-number for number in range(100)]
    assert run.events[0]["event"] == "light" and run.events[0]["on"] is True
    found = timing(run.shown)
    assert found["frames"] == 100 and found["late_ns"]["max"] == 99_000 and sum(found["histogram"]["counts"]) == 100
    assert (tmp_path / "run" / "rig.toml").read_text() == RIG and (tmp_path / "run" / "timing.json").is_file()
    with pytest.raises(StorageError, match="expected a new folder"):
        RunFolder.begin(tmp_path / "run", {}, RIG)


def test_a_torn_record_is_cut_off(tmp_path: Path) -> None:
    with RunFolder.begin(tmp_path / "run", {}, RIG) as folder:
        for number in range(3):
            folder.shown(FrameRecord(number, number, 0, 0, 1))
    with open(tmp_path / "run" / "shown.bin", "ab") as file:
        file.write(b"\x01" * 20)
    assert len(read_run(tmp_path / "run").shown) == 3 and read_run(tmp_path / "run").torn == 20
    with RunFolder.again(tmp_path / "run") as folder:
        folder.shown(FrameRecord(3, 3, 0, 0, 1))
    run = read_run(tmp_path / "run")
    assert run.shown["slot"].tolist() == [0, 1, 2, 3] and run.torn == 0


def test_a_full_disk_is_told(tmp_path: Path) -> None:
    with RunFolder.begin(tmp_path / "run", {}, RIG) as folder:
        folder.shown(FrameRecord(0, 0, 0, 0, 1))

        def full(file: int, data: bytes) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        folder._write = full
        with pytest.raises(StorageError, match="disk is full"):
            folder.shown(FrameRecord(1, 1, 0, 0, 1))
        folder._write = lambda file, data: os.write(file, data[:7])
        with pytest.raises(StorageError, match="7 of 60"):
            folder.shown(FrameRecord(1, 1, 0, 0, 1))
        folder._write = os.write
    assert len(read_run(tmp_path / "run").shown) == 1


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_still_learns_how_the_print_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    folder = RunFolder.begin(tmp_path / "run", {}, RIG)
    write = Path.write_text

    def full(place: Path, *rest: Any, **options: Any) -> int:
        if place.name == ".state.json":
            raise OSError(number, os.strerror(number))
        return write(place, *rest, **options)

    monkeypatch.setattr(Path, "write_text", full)
    for state, message in ((PrintState.HELD, "the disk is full; " * 20), (PrintState.ERROR, "held for too long")):
        folder.state(StateChange(PrintState.PRINTING, state, message))
        told = read_run(tmp_path / "run")
        assert (told.state, told.message) == (state, message)
    folder.close()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems take no space beforehand")
def test_space_for_the_whole_run_is_taken_before_the_light(tmp_path: Path) -> None:
    asked = {"slots": 100_000, "seconds": 3600.0, "views": {"frames": 360, "engines": 2, "on_ns": 1}}
    with RunFolder.begin(tmp_path / "run", asked, RIG) as folder:
        shown, events = (tmp_path / "run" / name for name in ("shown.bin", "events.jsonl"))
        assert shown.stat().st_size == len(MAGIC) and 512 * shown.stat().st_blocks >= 2 * 100_720 * 60
        assert 512 * events.stat().st_blocks > 3600 * 400
        folder.shown(FrameRecord(0, 0, 0, 0, 1))
        assert len(read_run(tmp_path / "run").shown) == 1
    assert shown.stat().st_size == len(MAGIC) + 60


def test_a_disk_without_space_for_the_run_is_told_before_the_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: int, size: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("vamgpu.hosts.records.record.take", full)
    with pytest.raises(StorageError, match="cannot take 600 bytes for the record of the run"):
        RunFolder.begin(tmp_path / "run", {"slots": 10}, RIG)


def test_the_record_of_a_dead_host_ends_in_the_light(tmp_path: Path) -> None:
    asked = {"slots": 4, "views": {"frames": 4, "engines": 1, "on_ns": 10**6}}
    folder = RunFolder.begin(tmp_path / "run", asked, RIG)
    folder.state(StateChange(PrintState.STANDBY, PrintState.PRINTING, ""))
    for slot in range(4):
        folder.shown(FrameRecord(slot, slot, slot, 0, 10**6))
    found = account(read_run(tmp_path / "run"))
    assert found is not None and found.open and not found.complete
    assert found.sure.tolist() == [[10**6] * 3 + [0]] and found.unsure.tolist() == [[0, 0, 0, 10**6]]
    assert "the record ends while the light was on" in str(found)
    folder.state(StateChange(PrintState.PRINTING, PrintState.COMPLETE, ""))
    found = account(read_run(tmp_path / "run"))
    assert found is not None and found.complete and not found.open and "all 4 frames have their light" in str(found)
    folder.close()


def test_a_killed_host_loses_no_frame(tmp_path: Path) -> None:
    script = """
        import sys
        from vamgpu.hosts.records.record import FrameRecord, RunFolder
        folder = RunFolder.begin(sys.argv[1], {}, "")
        for number in range(10**9):
            folder.shown(FrameRecord(number, number, 0, 0, 1))
            print(number, flush=True)
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", textwrap.dedent(script), str(tmp_path / "run")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as host:
        assert host.stdout is not None
        told = -1
        while told < 500:
            told = int(host.stdout.readline())
        host.send_signal(signal.SIGKILL)
        rest = [line for line in host.stdout.read().split("\n") if line]
    told = max([told, *(int(line) for line in rest[:-1])])
    slots = read_run(tmp_path / "run").shown["slot"].tolist()
    assert slots == list(range(len(slots))) and len(slots) > told


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="does not exist"):
        read_run(tmp_path / "nothing")
    RunFolder.begin(tmp_path / "run", {}, RIG).close()
    (tmp_path / "run" / "state.json").write_text('{"state": "dancing", "message": ""}')
    with pytest.raises(StorageError, match="not the folder of a run"):
        read_run(tmp_path / "run")
