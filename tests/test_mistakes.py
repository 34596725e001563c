"""Mistakes of newcomers end in an error of this library that says what was got and what was expected."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import VamError
from vamgpu.losses import VoxelLoss


@cache
def small() -> Any:
    """A solved print of a few voxels."""
    part = np.zeros((12, 12, 4), np.float32)
    part[3:9, 4:8] = 1.0
    target = vam.Target.from_array(part, 0.2)
    A = vam.Projection(target.grid, vam.Beam((16, 4), 0.2), vam.Turntable(12), None, "numpy")
    plan = vam.optimize(A, target, "bclp", 2)
    return SimpleNamespace(A=A, target=target, plan=plan, frames=vam.pack(plan), x=part, light=plan.sinogram.numpy())


def scene(shape: Callable[..., Any]) -> vam.Target:
    return vam.Scene([vam.Body(shape, name="odd")]).target(pitch=0.5, shape=(8, 8, 8), device="numpy")


def solved(s: Any, *method: Any, **given: Any) -> vam.Plan:
    return vam.optimize(s.A, s.target, *method, iterations=2, **given)


MISTAKES: dict[str, tuple[Callable[[Any], Any], str]] = {
    "axes exchanged": (lambda s: s.A.T(np.swapaxes(s.light, 0, 1)), r"shape \(16, 12, 4\)"),
    "flat array": (lambda s: s.A @ np.ones(7), "7"),
    "complex array": (lambda s: s.A(s.x.astype(complex)), "complex"),
    "list for an array": (
        lambda s: s.A([1, 2, 3]),
        r"is a list; expected an array of shape \(12, 12, 4\) = \[x, y, z\]",
    ),
    "text for an array": (lambda s: s.A("x"), "expected"),
    "NaN in an array": (lambda s: s.A(np.full(s.x.shape, np.nan)), "NaN"),
    "array of another device": (lambda s: s.A(vam.open_device("warp:cpu").upload(s.x)), "warp:cpu"),
    "factor": (lambda s: float("nan") * s.A, "expected a finite number"),
    "divided by 0": (lambda s: s.A / 0, "divided by 0"),
    "path for a plan": (lambda s: solved(s, resume="plan.vam"), r"got a str as resume; expected a Plan.*vam\.load"),
    "frames for a plan": (lambda s: solved(s, resume=s.frames), "got a Frames as resume"),
    "cancel": (lambda s: solved(s, cancel=True), "cancel is True; expected a function"),
    "no path to load": (lambda s: vam.load(None), "got a NoneType where a path is expected"),  # type: ignore[arg-type]
    "no path to save": (lambda s: s.plan.save(5), "got a int where a path is expected"),
    "no path to export": (lambda s: vam.export(s.frames, None), "where a path is expected"),  # type: ignore[arg-type]
    "plan exported": (lambda s: vam.export(s.plan, "a.npz"), r"got a Plan to export; expected the frames of vam\.pack"),
    "arguments exchanged": (lambda s: vam.simulate(s.frames, s.A, s.target), "expected"),
    "no bodies": (lambda s: vam.Scene(None), "got a NoneType as bodies; expected a list"),  # type: ignore[arg-type]
    "function of two": (lambda s: scene(lambda x, y: x), "function of body 'odd'.*expected φ"),
    "function of text": (lambda s: scene(lambda x, y, z: "solid"), "function of body 'odd'.*expected φ"),
    "vial in µm": (
        lambda s: vam.Vial(12000, 1.0, 1.5, 1.47),
        r"Vial radius \[mm\] is 12000; expected 0\.05 to 1000 mm.*12000 um was meant, write 12000 \* vamgpu\.units\.um",
    ),
    "vial in metres": (lambda s: vam.Vial(0.0124, 0.001, 1.5, 1.47), "if 0.0124 m was meant, write"),
    "pixels in µm": (lambda s: vam.Beam((16, 4), 67), r"Beam pitch \[mm\] is 67; .* if 67 um was meant"),
    "pixels in metres": (lambda s: vam.Beam((16, 4), 67e-6), "if 6.7e-05 m was meant"),
    "voxels in µm": (lambda s: vam.Grid((8, 8, 8), 67), r"Grid pitch \[mm\] is 67; expected at most 25 mm.*67 um was"),
    "phase function by name": (
        lambda s: vam.Scattering(0.6, phase=cast(Any, "henyey")),
        "Scattering phase is 'henyey'; expected pairs of an angle .* anisotropy sets",
    ),
    "loss that is a number": (
        lambda s: solved(s, VoxelLoss(np.square, part=cast(Any, 3))),
        "part of a VoxelLoss is 3; expected a funct",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_in_words_of_this_library(mistake: str, tmp_path: Path, monkeypatch: Any) -> None:
    make, said = MISTAKES[mistake]
    given = small()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(VamError, match=said):
        make(given)
    assert not list(tmp_path.iterdir())
