"""Whatever lies in a file's place, the library says what is wrong with it, soon and in little memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_inputs import CASES, MEMORY, SECONDS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some

import vamgpu as vam
from vamgpu.errors import BadInput, StorageError, VamError
from vamgpu.hosts.rigs.config import EMULATED, parse_rig
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.read import Job
from vamgpu.printing.folder import load_frames, save_frames
from vamgpu.storage import memory
from vamgpu.storage.memory import MEMORY as VARIABLE
from vamgpu.storage.memory import afford, budget
from vamgpu.storage.numpy_files import read_npz
from vamgpu.storage.reading import MOST_LEVELS, MOST_PARTS, is_file, open_file, parse_json, parse_toml, read_bytes

SCRIPT = Path(__file__).parents[1] / "hostile_inputs.py"
BREAKING = Path(__file__).parents[1] / "broken_files.py"
fuzzed = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What became of every hostile input, each read in a child of its own."""
    words = [sys.executable, str(SCRIPT), str(tmp_path_factory.mktemp("hostile"))]
    run = subprocess.run(words, capture_output=True, text=True, timeout=250)
    assert run.returncode == 0, run.stderr[-2000:]
    return {found["name"]: found for found in map(json.loads, run.stdout.splitlines())}


@pytest.mark.slow
@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="pipes, sockets and children's memory as Linux has them"
)
def test_hostile_inputs_end_as_errors_of_their_kind(results: dict[str, Any]) -> None:
    assert set(results) == set(CASES) and len(CASES) >= 240
    wrong = {name: found for name, found in results.items() if found["ended"] != "typed" or len(found["said"]) < 20}
    assert not wrong
    assert max(found["work"] for found in results.values()) < SECONDS
    greedy = {name: found["memory"] for name, found in results.items() if found["memory"] > MEMORY}
    assert not greedy


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of memory as Linux has them")
@pytest.mark.parametrize("rounds", [10, pytest.param(1000, marks=pytest.mark.slow)])
def test_broken_files_are_read_or_refused(rounds: int, tmp_path: Path) -> None:
    """Within ten seconds and a gigabyte each."""
    words = [sys.executable, str(BREAKING), str(tmp_path), str(rounds)]
    run = subprocess.run(words, capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr[-2000:]
    results = list(map(json.loads, run.stdout.splitlines()))
    assert not [found for found in results if "error" in found]
    assert sum(found["read"] + found["refused"] for found in results) >= 45 * rounds
    assert all(found["refused"] for found in results)


@pytest.mark.parametrize("place, flag, said", [(6, 192, "version"), (8, 0x20, "encrypted"), (8, 0x40, "encrypted")])
def test_zips_that_python_cannot_unpack_are_refused(place: int, flag: int, said: str, tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    np.savez(file, a=np.zeros(3))
    data = bytearray(file.read_bytes())
    data[data.index(b"PK\x01\x02") + place] |= flag
    file.write_bytes(data)
    with pytest.raises(StorageError, match=said):
        read_npz(file)


def test_messages_name_the_claim_the_budget_and_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "1.5 GB")
    assert budget() == 1_500_000_000
    with pytest.raises(StorageError, match=r"^'a\.zarr' takes 18 GB of memory; the budget is 1\.5 GB: .*MEMORY=18GB$"):
        afford(18e9, "'a.zarr'")
    afford(1.5e9, "'a.zarr'")
    monkeypatch.setenv(VARIABLE, "3GiB")
    assert budget() == 3 << 30
    for odd in ("much", "-3 GB", "0", "3 XB", "1e9", "nan"):
        monkeypatch.setenv(VARIABLE, odd)
        with pytest.raises(BadInput, match="expected a size such as"):
            budget()
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(memory, "installed", lambda: 32 << 30)
    assert budget() == 16 << 30


def test_sound_texts_are_read_as_before(tmp_path: Path) -> None:
    text = 'a.b."c.d" = 1\nlist = [0.5, 1.5]\nsaid = "' + "No. " * 100 + '"\n' + "numbers = [" + "0.25, " * 1000 + "]\n"
    assert parse_toml(text) == tomllib.loads(text)
    assert parse_toml(JOB) == tomllib.loads(JOB) and parse_toml(EMULATED) == tomllib.loads(EMULATED)
    deep = "a=" + "[" * MOST_LEVELS + "]" * MOST_LEVELS
    assert parse_toml(deep) and parse_toml(".".join("a" * MOST_PARTS) + "=1")
    for beyond in (deep.replace("=", "=[") + "]", ".".join("a" * (MOST_PARTS + 1)) + "=1"):
        with pytest.raises(tomllib.TOMLDecodeError, match="more than 64"):
            parse_toml(beyond)
    assert parse_json(f"[{2**63 - 1}, -{2**63}, 1e308, true, null]")[0] == 2**63 - 1
    for number in (f"{2**63}", "NaN", "-Infinity", "1e309"):
        with pytest.raises(ValueError, match=r"expected"):
            parse_json(f'{{"a": [{number}]}}')
    (tmp_path / "a").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("a")
    assert read_bytes(tmp_path / "link", 5) == b"12345"
    with pytest.raises(OSError, match="it has 5 bytes, expected 4"):
        read_bytes(tmp_path / "a", 4)
    assert not is_file("n" * 5000) and not is_file("a\0b") and not is_file(tmp_path)
    with pytest.raises(OSError, match="it is a folder"):
        open_file(tmp_path)


def test_a_pipe_that_comes_after_the_look_is_no_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file may change between being looked at and being opened."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    look = os.stat
    monkeypatch.setattr(os, "stat", lambda path: look(tmp_path / "file"))
    with pytest.raises(OSError, match="pipe"):
        open_file(tmp_path / "pipe")


scalars = some.none() | some.booleans() | some.integers() | some.floats() | some.text(max_size=8)
values = some.recursive(scalars, lambda inner: some.lists(inner, max_size=3) | some.dictionaries(
    some.text(max_size=5), inner, max_size=3), max_leaves=6)  # fmt: skip


@fuzzed
@given(cut=some.tuples(some.integers(0, 3000), some.integers(0, 30)), junk=some.text(max_size=12))
@pytest.mark.parametrize(("text", "parse"), [(JOB, Job.parse), (EMULATED, parse_rig)], ids=["job", "rig"])
def test_spoiled_texts_are_read_or_refused(text: str, parse: Any, cut: tuple[int, int], junk: str) -> None:
    begin = cut[0] % len(text)
    try:
        parse(text[:begin] + junk + text[begin + cut[1] :])
    except VamError as error:
        assert len(str(error)) > 20


@pytest.mark.slow
@fuzzed
@given(which=some.integers(0, 10**6), value=values)
@pytest.mark.parametrize(("text", "parse"), [(JOB, Job.parse), (EMULATED, parse_rig)], ids=["job", "rig"])
def test_spoiled_values_are_read_or_refused(text: str, parse: Any, which: int, value: Any) -> None:
    lines = [number for number, line in enumerate(text.splitlines()) if " = " in line and line[0] != "#"]
    spoiled, at = text.splitlines(), lines[which % len(lines)]
    spoiled[at] = f"{spoiled[at].partition('=')[0]}= {toml(value)}"
    try:
        parse("\n".join(spoiled))
    except VamError as error:
        assert len(str(error)) > 20


def toml(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in value.items()) + "}"
    return "0" if value is None else str(value) if isinstance(value, float) else json.dumps(value)


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import numpy as np

    from vamgpu.printing.frames import Frames
    from vamgpu.printing.gray import GrayCurve

    path = tmp_path_factory.mktemp("frames") / "a.vam"
    gray = GrayCurve((0, 100, 255), (0.0, 3.0, 10.0))
    images = np.random.default_rng(0).integers(0, 256, (3, 4, 5), np.uint8)
    save_frames(path, Frames.from_bytes(images, vam.open_device("numpy"), bits=8, scale=1.0, columns=5, gray=gray))
    return path


@fuzzed
@given(which=some.integers(0, 10**6), value=values)
def test_spoiled_manifests_are_read_or_refused(frames: Path, which: int, value: Any) -> None:
    file = frames / "manifest.json"
    sound = file.read_text()
    data = json.loads(sound)
    holders = [(data, key) for key in data]
    for holder, key in holders:
        inner = holder[key]
        keys = inner if isinstance(inner, dict) else range(len(inner)) if isinstance(inner, list) else ()
        holders.extend((inner, each) for each in keys)
    holder, key = holders[which % len(holders)]
    holder[key] = value
    file.write_text(json.dumps(data))
    try:
        load_frames(frames, "numpy")
    except VamError as error:
        assert len(str(error)) > 20
    finally:
        file.write_text(sound)
