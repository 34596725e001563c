"""The camera of watched prints is measured on emulated machines, and prints take what was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_print import printer, setup

from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError, StorageError
from vamgpu.hosts.calibrate import live as live_run
from vamgpu.hosts.calibrate.connection import rehearsal
from vamgpu.hosts.calibrate.report import keep
from vamgpu.hosts.calibrate.truth import compared
from vamgpu.hosts.emulators.calibration import Optics
from vamgpu.hosts.live.cameras import RedCamera, _measured
from vamgpu.hosts.rigs.calibrations import MEASURED, measured
from vamgpu.hosts.rigs.config import EMULATED, RigConfig, read_rig
from vamgpu.live import LiveRecord, Truth, Turbidity
from vamgpu.live.first_cure import turbidity_of
from vamgpu.live.sensor import SensorView

CAMERA = 'pixel = "7.8 um"\nbits = 12\ncrop = [0, 0, 640, 480]\nflip = true\nrotation = 90'
BACK = 3.0e6


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> RigConfig:
    path = tmp_path_factory.mktemp("lab") / "lab.toml"
    path.write_text(EMULATED.replace('pixel = "7.8 um"', CAMERA))
    return read_rig(path)


@pytest.fixture(scope="module")
def found(rig: RigConfig) -> RedCamera:
    """Of 640 × 480 pixels, mirrored, turned by 90°, 12 bits."""
    machines, optics = rehearsal(rig, (*live_run.TABLES, "camera_stage"), kind="live")
    try:
        keep(compared(live_run.live(machines, repeats=4), optics, machines), rig)
    finally:
        machines.close()
    return _measured(measured(rig, "live"))


def test_levels_noise_and_place_are_found_within_their_errors(rig: RigConfig, found: RedCamera) -> None:
    tables = measured(rig, "live").tables()
    told, true = tables[MEASURED], tables["emulated"]
    assert abs(told["dark"] - true["dark"]) < 3.0 * told["dark_error"] and told["dark_error"] < 0.1
    assert told["open_field"] == pytest.approx(true["open_field"], rel=0.002)
    assert told["gain"] == pytest.approx(true["gain"], rel=0.02) and told["read"] == pytest.approx(
        true["read"], rel=0.1
    )
    assert (
        found.view is not None
        and found.view.shape == (480, 640)
        and "mirrored, turned by 90.0" in found.view.orientation
    )
    optics = Optics()
    true_view = SensorView.described(
        (480, 640), optics.mirrors, optics.pitch / 0.0078, flip=True, rotation=90, dark=true["dark"], bits=12
    )
    corners = np.array([(row, column) for row in (0, 95) for column in (0, 191)], float).T
    seen, wanted = (
        np.array(view.matrix) @ corners + np.array(view.origin)[:, None] for view in (found.view, true_view)
    )
    assert np.abs(seen - wanted).max() < 3.0 * max(told["place_error_pixels"], 0.02)
    assert found.turbidity.error == 0.2, "it was not measured"
    field = np.asarray(found.open_field)
    assert field.shape == (480, 640) and field[240, 320] > 1.15 * field[0, 0], "the light's vignetting"


@pytest.mark.parametrize(("read", "gain"), [(0.8, 0.01), (0.3, 0.002), (0.1, 0.002), (1.9, 0.0)])
def test_noise_below_the_rounding_of_levels_is_measured_with_its_error(read: float, gain: float) -> None:
    random, field = np.random.default_rng(0), np.linspace(160.0, 200.0, 20_000)
    stacks = []
    for share in live_run.SHARES:
        level = 2.3 + share * field
        noise = np.sqrt(read**2 + gain * share * field) * random.standard_normal((4, field.size))
        stacks.append(np.rint(level + noise).astype(np.float32))
    level, variance = live_run._by_level(stacks)
    found, electrons, error, other = live_run._noise(level - 2.3, variance)
    assert abs(found - read) < 3.0 * error < 0.6 * read and abs(electrons - gain) < 3.0 * other < 0.001


def test_a_camera_whose_images_would_repeat_is_refused() -> None:
    field = 2.3 + np.linspace(160.0, 200.0, 20_000)
    noise = 0.15 * np.random.default_rng(0).standard_normal((4, field.size))
    with pytest.raises(BadInput, match="is 0.15 gray levels; expected 0.25 or more.*bits"):
        live_run._noise(*live_run._by_level([np.rint(field + noise).astype(np.float32)]))


def test_a_place_is_kept_and_damage_is_told(rig: RigConfig, found: RedCamera, tmp_path: Path) -> None:
    place = {name: measured(rig, "live").tables()[MEASURED][name] for name in live_run.PLACE}
    machines, _ = rehearsal(rig, live_run.TABLES, Optics(back=BACK, view=(640, 480), flip=True, rotation=90))
    shown: list[object] = []
    machines.screens[0].show = shown.append  # type: ignore[method-assign]
    with pytest.raises(BadInput, match="2 or more"):
        live_run.live(machines, repeats=1)
    again = live_run.live(machines, repeats=2, place=place)
    machines.close()
    assert again.numbers["matrix"] == place["matrix"] and not shown, "no mirror was lit"
    dark, _ = rehearsal(rig, live_run.TABLES, Optics(back=0.0))
    with pytest.raises(BadInput, match="turn its own light on"):
        live_run.live(dark, repeats=2, place=place)
    dark.close()
    with pytest.raises(JobError, match="vam calibrate live"):
        measured(read_rig("emulated"), "live")
    path = measured(rig, "live").path
    np.savez(tmp_path / "none.npz")
    (tmp_path / "result.toml").write_text((path / "result.toml").read_text().replace("origin", "origins"))
    with pytest.raises(StorageError, match="malformed"):
        _measured(type(measured(rig, "live"))("live", measured(rig, "live").taken, tmp_path))


def test_the_command_measures_and_keeps_the_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(EMULATED)
    assert main(["calibrate", "live", "--rig", str(rig), "--keep-place"]) == 1
    assert "no calibration of live" in capsys.readouterr().err
    assert main(["calibrate", "live", "--rig", str(rig), "--repeats", "2"]) == 0
    assert main(["calibrate", "live", "--rig", str(rig), "--repeats", "2", "--keep-place"]) == 0
    told = capsys.readouterr().out
    assert told.count("gray levels per electron") == 2 and "camera pixels per mirror" in told
    assert main(["calibrate", "live", "--rig", str(rig), "--cured", str(tmp_path / "none")]) == 1


@pytest.mark.slow
@pytest.mark.parametrize(("full", "lamp"), [(0.25, 0.9), (0.2, 1.0)])
def test_the_first_cure_tells_the_turbidity(full: float, lamp: float, tmp_path: Path) -> None:
    made, part, light = setup()
    record, live = LiveRecord(tmp_path / "cure"), printer(Truth(lamp=lamp))
    live.turbidity = Turbidity((0.0, 1.0), (0.0, full))
    loop = record.begin(made, part, light)
    state, action = loop.start(), "keep"
    with pytest.raises(StorageError, match="no decision"):
        turbidity_of(record)
    while action != "stop":
        live.turn(live.dose(np.asarray(state.light)))
        frames = live.through()
        state, decision = loop.decide(state, frames)
        record.add(frames, decision)
        action = decision.action
        if decision.turn == 1:
            with pytest.raises(BadInput, match="has cured"):
                turbidity_of(record)
    told = turbidity_of(record)
    assert abs(told.full - full) < 2.0 * told.error < 0.06 * full
