"""Light of scans that are not even, from the plan to the bytes and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import BadInput, ShapeMismatch, StorageError
from vamgpu.printing.folder import describe, load_frames, save_frames
from vamgpu.storage.manifest import plain
from vamgpu.storage.turntable import described, turntable_from
from vamgpu.units import deg

GRID, BEAM = vam.Grid((20, 20, 4), 0.1), vam.Beam((28, 4), 0.1)
MOTIONS = {
    "measured": vam.Turntable(np.sort(np.random.default_rng(4).uniform(0, 2 * np.pi, 40))),
    "arc": vam.Turntable.arc(30, 120 * deg, start=-60 * deg),
    "unequal times": vam.Turntable(40, dwell=np.linspace(1, 3, 40)),
}

ROUNDED = vam.Turntable(37, dwell=np.random.default_rng(0).uniform(0.5, 2, 37))
"""The mean of its times is not quite one."""


def part() -> np.ndarray:
    target = np.zeros(GRID.shape, np.float32)
    target[6:12, 6:14, 1:3] = 1.0
    return target


@pytest.mark.slow
@pytest.mark.parametrize(
    "scan", ["measured", *(pytest.param(scan, marks=pytest.mark.slow) for scan in ("arc", "unequal times"))]
)
def test_the_report_names_the_angles(scan: str, tmp_path: Path) -> None:
    motion = MOTIONS[scan]
    A = vam.Projection(GRID, BEAM, motion, device="numpy")
    proof = vam.simulate(A, vam.pack(vam.optimize(A, part(), "recipe", iterations=1)), part())
    page = proof.report(tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count(str(motion)) == 2 and f"angles downwards, {motion}." in page
    for pose in (round(k * motion.angles / 4) for k in range(4)):
        assert f"<figcaption>{np.degrees(motion.poses[pose]):g}°</figcaption>" in page


@pytest.mark.parametrize("scan", MOTIONS)
def test_frames_come_back_with_their_angles_and_print_what_was_planned(fast_device, scan: str, tmp_path: Path) -> None:
    motion = MOTIONS[scan]
    A = vam.Projection(GRID, BEAM, motion, device=fast_device)
    plan = vam.optimize(A, part(), iterations=4)
    frames = vam.pack(plan, quantile=1.0)
    assert frames.motion == motion
    save_frames(tmp_path / "part.vam", frames)
    again = load_frames(tmp_path / "part.vam", fast_device)
    assert again.motion == motion
    proof = vam.simulate(A, again, part(), irradiance=10.0, critical_dose=5.0, absorption=0.05)
    assert proof.scores.window == pytest.approx(plan.window, abs=2 / 255)
    light = frames.irradiance(A.device).numpy() * motion.times[:, None, None]
    assert proof.mean_brightness == pytest.approx(light.mean() / frames.scale, rel=1e-4)
    assert proof.exposure is not None
    sent = light.sum() * 10.0 / frames.scale * BEAM.pixel_area * proof.exposure.seconds / motion.angles
    assert proof.exposure.energy == pytest.approx(sent, rel=1e-4)
    assert proof.light_efficiency == pytest.approx(proof.dose.numpy()[part() > 0].sum() / light.sum(), rel=1e-3)


def test_frames_of_other_angles_are_refused() -> None:
    one, other = (vam.Projection(GRID, BEAM, motion, device="numpy") for motion in (
        MOTIONS["measured"], vam.Turntable(40)))  # fmt: skip
    frames = vam.pack(vam.optimize(one, part(), "recipe", iterations=1))
    with pytest.raises(BadInput, match=r"frames are for Turntable\(angles=\[.*has Turntable\(angles=40\).*same angles"):
        vam.simulate(other, frames, part())
    with pytest.raises(ShapeMismatch, match="40 frames are for 7 over a full turn"):
        vam.Frames(frames.images, 8, frames.gray, frames.scale, frames.columns, motion=vam.Turntable(7))


def test_errors_diffuse_among_poses_that_are_lit_as_long() -> None:
    plans = [vam.optimize(vam.Projection(GRID, BEAM, MOTIONS[scan], device="numpy"), part(), "recipe", iterations=1)
             for scan in ("arc", "unequal times")]  # fmt: skip
    light = plans[0].sinogram.numpy()
    sums = [vam.pack(plans[0], bits=1, dither=dither, quantile=1.0).irradiance().numpy().sum(axis=0) - light.sum(axis=0)
            for dither in ("round", "error-diffusion")]  # fmt: skip
    assert np.abs(sums[1]).max() < 0.5 * np.abs(sums[0]).max()
    with pytest.raises(
        BadInput, match=r'error-diffusion got angles of 40 over a full turn, each lit .* use dither="round"'
    ):
        vam.pack(plans[1], bits=1, dither="error-diffusion")


@pytest.mark.parametrize(
    "motion", [*MOTIONS.values(), vam.Turntable(12), ROUNDED, vam.Turntable([0.1, 0.1, 3], [1, 2, 1])]
)
def test_a_turntable_comes_back_from_json_to_the_last_bit(motion: vam.Turntable) -> None:
    assert turntable_from(json.loads(json.dumps(plain(described(motion))))) == motion


def test_folders_of_earlier_versions_are_read(tmp_path: Path) -> None:
    assert turntable_from({"angles": 360}) == vam.Turntable(360, lit_share=0.0)
    plan = vam.optimize(vam.Projection(GRID, BEAM, vam.Turntable(8), device="numpy"), part(), "recipe", iterations=1)
    save_frames(tmp_path / "part.vam", vam.pack(plan))
    file = tmp_path / "part.vam" / "manifest.json"
    manifest = json.loads(file.read_text(encoding="utf-8"))
    assert manifest["details"]["frames"].pop("turntable") == {"angles": 8, "lit_share": 1.0}
    file.write_text(json.dumps(manifest), encoding="utf-8")
    old = load_frames(tmp_path / "part.vam", "numpy")
    assert old.motion is None and "turntable" not in describe(old)


@pytest.mark.parametrize(
    ("said", "garbled"),
    [
        ("theta", {"angles": 3, "theta": "many"}),
        ("3 angles, and 2 measured", {"angles": 3, "theta": [0.0, 1.0]}),
        ("dwell", {"angles": 3, "dwell": [1, 2]}),
        ("'angles'", {"theta": [0.0, 1.0]}),
    ],
)
def test_a_garbled_turntable_is_told(said: str, garbled: dict) -> None:
    with pytest.raises(StorageError, match=said if said != "theta" else "turntable in the manifest is malformed"):
        turntable_from(garbled)
