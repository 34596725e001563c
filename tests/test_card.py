"""What a notebook shows: pictures that open, numbers with units, and nothing that a name could smuggle in."""

from __future__ import annotations

import re
from base64 import b64decode
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
import pytest
import rich
from PIL import Image

import vamgpu as vam
from vamgpu import card as module
from vamgpu.card import card
from vamgpu.methods import progress

HOSTILE = "<script>alert('x')</script>\"'"


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    """One object of each kind, named as an attacker would."""
    x, y = np.mgrid[:16, :16] - 7.5
    part = (np.hypot(x, y) < 4)[:, :, None] * np.ones(6)
    target = vam.Target.from_array(part, pitch=0.25, name=HOSTILE)
    A = vam.Projection(target.grid, vam.Beam((16, 6), 0.25), vam.Turntable(12), device="numpy")
    plan = vam.optimize(A, target, iterations=3)
    frames = vam.pack(plan, bits=8)
    proof = vam.simulate(A, frames, target)
    assert proof.verdict.proved, "a card shows the verdict once it is known"
    nouns = {"grid": A.grid, "beam": vam.Beam((16, 6), 0.25, fill=0.9), "motion": vam.Turntable.arc(12, np.pi)}
    vial = vam.Vial(radius=4.0, wall=0.5, resin_index=1.5, wall_index=1.47, absorption=0.05)
    bodies = [vam.Body(part, pitch=0.25, name=HOSTILE), vam.Body(part, "gray", HOSTILE, dose=0.7, pitch=0.25)]
    nouns |= {"vial": vial, "scene": vam.Scene([*bodies, vam.Body(lambda x, y, z: x + y + z, "insert")])}
    return nouns | {"target": target, "operator": A, "transpose": A.T, "plan": plan, "frames": frames, "proof": proof}


def pictures(html: str) -> list[np.ndarray]:
    """The images inside, [row, column, color]."""
    return [np.asarray(Image.open(BytesIO(b64decode(data)))) for data in re.findall(r"base64,([\w+/=]+)", html)]


@pytest.mark.parametrize(
    ("kind", "count", "said"),
    [
        ("target", 2, ("250 µm", "mm³", "16 × 16 × 6")),
        ("operator", 1, ("12 × 16 × 6", "numpy", "[angle, r, z]")),
        ("transpose", 1, ("12 × 16 × 6",)),
        ("plan", 2, ("strict window", "12 × 16 × 6")),
        ("frames", 1, ("12 of 16 × 6 pixels", "8 bits")),
        ("grid", 0, ("[16, 16, 6]", "0.25 mm", "4 × 4 × 1.5 mm")),
        ("beam", 0, ("[16, 6]", "0.25 mm", "4 × 1.5 mm", "0.9", "0.5 pixels")),
        ("motion", 1, ("12 measured, from 0° to 165°", "lit share")),
        ("vial", 1, ("4.0 mm", "0.05 1/mm", "out to", "2.667 of 3.5 mm")),
        ("scene", 0, ("1: ", "gray, dose 0.7, to 0.952 mm", "z -0.75 to 0.75 mm", "insert, by a function")),
        ("proof", 3, ("process window, strict", "verdict", "IoU")),
    ],
)
def test_an_object_shows_pictures_and_numbers(
    made: dict[str, Any], kind: str, count: int, said: tuple[str, ...]
) -> None:
    html = made[kind]._repr_html_()
    seen = pictures(html)
    assert len(seen) == count and all(image.std() > 1 for image in seen)  # none is blank
    assert all(words in html for words in said)
    assert "<script" not in html


def test_a_picture_stands_upright() -> None:
    plane = np.zeros((4, 2))
    plane[0, 1] = 1.0  # left, above
    (image,) = pictures(card("", {}, {"": plane}))
    assert image.shape == (module.SIDE // 2, module.SIDE, 3)
    assert image[0, 0].sum() > 600 and image[-1, 0].sum() < 60 and image[0, -1].sum() < 60


def test_everything_is_escaped() -> None:
    html = card(HOSTILE, {HOSTILE: HOSTILE}, {HOSTILE: np.ones((2, 2))})
    assert "<script" not in html and html.count("&lt;script&gt;") == 5
    assert "alert('x')" not in html  # an attribute would end there


def test_large_arrays_stay_where_they_are(made: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LARGEST", 10)
    for kind in ("target", "operator", "plan", "frames", "proof"):
        html = made[kind]._repr_html_()
        assert not pictures(html) and "too large to be drawn" in html


def test_mended_meshes_say_so(made: dict[str, Any]) -> None:
    target = made["target"]
    assert "mended" not in target._repr_html_()
    solid = type("Mended", (), {"mended": ("closed 2 holes <b>",)})()
    assert "closed 2 holes &lt;b&gt;" in replace(target, solid=solid)._repr_html_()


@pytest.mark.parametrize("looks", [True, False])
def test_a_bar_is_shown_where_somebody_looks(
    made: dict[str, Any], looks: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "watched", lambda: looks)
    monkeypatch.setenv("FORCE_COLOR", "1")  # the bar is told that there is a terminal, and one that moves its cursor
    monkeypatch.setenv("TERM", "xterm")
    rich.reconfigure()  # its console may be older than these settings
    vam.optimize(made["operator"], made["target"], iterations=2)
    assert ("left" in capsys.readouterr().out) is looks
    vam.optimize(made["operator"], made["target"], iterations=2, progress=False)
    assert capsys.readouterr().out == ""
