"""What ``vam view`` hands to napari, with a stand-in for it."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.cli import main
from vamgpu.cli.view import layers


@pytest.fixture(scope="module")
def proof() -> Any:
    part = np.zeros((12, 14, 6))
    part[4:8, 5:9, 1:4] = 1.0
    target = vam.Target.from_array(part, pitch=0.25, name="block")
    A = vam.Projection(target.grid, vam.Beam((16, 6), 0.25), vam.Turntable(12), device="numpy")
    return vam.simulate(A, vam.pack(vam.optimize(A, target, iterations=3)), target)


def test_layers_stand_where_the_part_is(proof: Any) -> None:
    found = {layer["name"]: layer for layer in layers(proof)}
    assert list(found) == ["frames", "dose", "target", "printed"]
    assert found["frames"]["data"].shape == proof.frames.shape
    target = found["target"]
    assert target["data"].shape == (6, 14, 12) and target["data"][1:4, 5:9, 4:8].all()
    assert target["scale"] == [0.25] * 3 and np.allclose(target["translate"], [-0.625, -1.625, -1.375])
    assert found["printed"]["data"].sum() == (proof.dose.numpy() >= proof.scores.threshold).sum()


def test_the_command_shows_every_layer(proof: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    shown: list[str] = []

    class Viewer:
        def __init__(self, title: str) -> None:
            shown.append(title)

        def add_image(self, data: np.ndarray, name: str, **_: Any) -> None:
            shown.append(name)

    napari = SimpleNamespace(Viewer=Viewer, run=lambda: shown.append("run"))
    monkeypatch.setitem(sys.modules, "napari", napari)  # type: ignore[arg-type]
    monkeypatch.setattr("vamgpu.jobs.run.prove", lambda path, device, progress: SimpleNamespace(proof=proof))
    assert main(["view", str(tmp_path)]) == 0
    assert shown == ["block", "frames", "dose", "target", "printed", "run"]


def test_without_napari_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "napari", None)
    assert main(["view", str(tmp_path)]) == 1
    assert 'pip install "vamgpu[view]"' in capsys.readouterr().err
