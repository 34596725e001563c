"""A machine where the user's cache folder cannot be written, and one where drivers are hidden as well."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import vamgpu
from vamgpu.backend import kernel_cache
from vamgpu.cli import doctor
from vamgpu.errors import StorageError

JOB = """[target]
shape = "nut"
height = "2 mm"
pitch = "400 um"

[beam]
pitch = "400 um"

[turntable]
angles = 20

[solve]
iterations = 2
"""


def fresh(tmp_path: Path, **more: str) -> dict[str, str]:
    """An environment whose home is below a file, so that not even root can write there."""
    (tmp_path / "file").touch()
    kept = {key: value for key, value in os.environ.items() if key not in ("XDG_CACHE_HOME", "WARP_CACHE_PATH")}
    return {**kept, "HOME": str(tmp_path / "file" / "home"), **more}


def vam(*words: str, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "vamgpu.cli", *words], env=env, capture_output=True, text=True,
                          check=False)  # fmt: skip


@pytest.mark.skipif(sys.platform != "linux", reason="other systems keep caches elsewhere")
def test_devices_work_where_home_cannot_be_written(tmp_path: Path) -> None:
    listed = vam("devices", env=fresh(tmp_path, TMPDIR=str(tmp_path)))
    assert listed.returncode == 0, listed.stderr
    assert tuple(listed.stdout.split()) == vamgpu.devices()
    assert not list(tmp_path.glob("vamgpu-kernels-*"))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems keep caches elsewhere")
@pytest.mark.parametrize("hidden", [{}, {"OCL_ICD_VENDORS": "/nonexistent"}], ids=["all drivers", "drivers hidden"])
def test_doctor_and_solve_work_where_home_cannot_be_written(tmp_path: Path, hidden: dict[str, str]) -> None:
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    env = fresh(tmp_path, **hidden)
    solved = vam("solve", str(tmp_path / "job.toml"), env=env)
    assert solved.returncode == 0, solved.stderr
    said = vam("doctor", env=env).stdout
    assert "cache of kernels" in said and "XDG_CACHE_HOME" in said and "crashes its process" not in said
    listed = vam("devices", env=env).stdout.split()
    assert all(any(line.startswith(f"works   {name}") for line in said.splitlines()) for name in listed)


def test_an_unwritable_cache_without_a_temporary_folder_is_a_typed_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise OSError("Read-only file system")

    kernel_cache.refusal.cache_clear()
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("HOME", fresh(tmp_path)["HOME"])
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("vamgpu.backend.kernel_cache.tempfile.TemporaryDirectory", refused)
    try:
        with pytest.raises(StorageError, match="Not a directory.*Read-only.*set XDG_CACHE_HOME or TMPDIR"):
            kernel_cache.writable.__wrapped__()
    finally:
        kernel_cache.refusal.cache_clear()


def test_the_doctor_blames_no_driver_for_folders(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused() -> None:
        raise StorageError("cannot keep compiled kernels: no disk; set TMPDIR")

    monkeypatch.setattr("vamgpu.cli.doctor.writable", refused)
    assert doctor.answer(["list"]) == {"error": "cannot keep compiled kernels: no disk", "remedy": "set TMPDIR"}
    monkeypatch.setattr(doctor, "_ask", lambda arguments, limit: doctor.answer(arguments))
    (found,) = doctor.examine()
    assert found.remedy == "set TMPDIR"
