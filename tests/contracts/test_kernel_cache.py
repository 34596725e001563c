"""Binaries of kernels in the user's cache: used by later processes, and made again where they are spoiled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyopencl as cl
import pytest

import vamgpu
from vamgpu.backend import kernel_cache, opencl
from vamgpu.kernels.update import linear


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache, empty, of a driver that keeps no binaries."""

    def path(*_: object, **__: object) -> Path:
        return tmp_path

    monkeypatch.setattr(kernel_cache, "user_cache_path", path)
    monkeypatch.setattr(opencl, "has_src_build_cache", lambda _: False)
    return tmp_path


def built(monkeypatch: pytest.MonkeyPatch) -> tuple[list[bool], Any]:
    """Compile one kernel; whether each program that was built came from a binary, and the kernel."""
    kinds: list[bool] = []
    build = cl.Program.build

    def noted(program: Any, *arguments: Any, **named: Any) -> Any:
        kinds.append(program._prg is not None)
        return build(program, *arguments, **named)

    device: Any = vamgpu.open_device("opencl")
    with monkeypatch.context() as patch:
        patch.setattr(cl.Program, "build", noted)
        return kinds, device.compile(linear, 16)


def test_a_later_process_takes_the_binary(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert built(monkeypatch)[0] == [False]
    assert built(monkeypatch)[0] == [True]
    assert len(list(place.iterdir())) == 1, "no temporary file is left"


def test_a_spoiled_binary_is_made_again(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built(monkeypatch)
    (file,) = place.iterdir()
    right = file.read_bytes()
    file.write_bytes(b"spoiled")
    assert built(monkeypatch)[0] == [False]
    assert len(file.read_bytes()) > len(right) // 2
    assert built(monkeypatch)[0] == [True]


def test_a_cache_that_cannot_be_written_costs_only_time(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(kernel_cache.os, "replace", full)
    for _ in range(2):
        assert built(monkeypatch)[0] == [False]
    assert not list(place.iterdir()), "no temporary file is left"
