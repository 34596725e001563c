"""Calibrations on emulated optics with blur and noise: they find the truth, and are dark first when they cannot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from servers import PtyServer
from tcp_server import TcpServer

from vamgpu.calibration.pointspread import PointSpread
from vamgpu.errors import BadInput, DeviceNotFound, JobError, StorageError
from vamgpu.geometry import Beam
from vamgpu.hosts.calibrate import axis as axis_run
from vamgpu.hosts.calibrate import focus as focus_run
from vamgpu.hosts.calibrate import gray as gray_run
from vamgpu.hosts.calibrate import mtf as mtf_run
from vamgpu.hosts.calibrate.connection import opened, rehearsal
from vamgpu.hosts.calibrate.machines import CalibrationMachines
from vamgpu.hosts.calibrate.report import CalibrationResult, focused_at, read, save
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel, Stored
from vamgpu.hosts.emulators.calibration import EmulatedMeter, Optics
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.rigs.config import EMULATED, RigConfig, parse_rig, read_rig
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.printing.gray import GrayCurve

ALL = ("lens", "camera", "camera_stage", "photodiode")
TWO = EMULATED.replace("[display]", "[[display]]") + '\n[[display]]\ndriver = "emulated"\n'


def rehearsed(rig: RigConfig | None = None, truth: Optics | None = None) -> tuple[CalibrationMachines, Any]:
    stand, _ = rehearsal(rig or read_rig("emulated"), ALL, truth)
    return stand, laboratory_of(stand)


def laboratory_of(stand: CalibrationMachines) -> Any:
    return stand.camera.emulated  # type: ignore[union-attr]


def small_focus(stand: CalibrationMachines) -> CalibrationResult:
    return focus_run.focus(stand, focus_run.steps(2.0, 1.0), focus_run.sweep(-0.25, 0.25, 17))


def test_focus_finds_the_line_of_the_optics() -> None:
    truth = Optics(slope=-39.2, middle=-0.8, seed=3)
    stand, emulated = rehearsed(truth=truth)
    found = small_focus(stand).numbers
    assert found["slope_mm_dpt"] == pytest.approx(-39.2, rel=0.005)
    assert found["axis_dpt"] == pytest.approx(-0.8 / 39.2, abs=0.002)
    assert found["slope_error_mm_dpt"] < 0.1
    assert not emulated.box.light and not emulated.box.armed


def test_axis_finds_both_edges_of_the_roller() -> None:
    truth = Optics(axis=90.7, radius=50.4, shadow=2.0, seed=4)
    stand, emulated = rehearsed(truth=truth)
    found = axis_run.axis(stand).numbers
    assert found["column"] == pytest.approx(90.7, abs=0.05)
    assert found["radius_columns"] == pytest.approx(50.4, abs=0.05)
    assert found["shift_columns"] == pytest.approx(90.7 - 95.5, abs=0.05)
    assert found["edge_widths"] == pytest.approx([2.0, 2.0], abs=0.2)
    assert not emulated.box.light


def test_one_edge_wants_a_radius_and_a_coarse_scan_suffices() -> None:
    stand, _ = rehearsed()
    with pytest.raises(BadInput, match="one edge"):
        axis_run.axis(stand, stop=90, every=2)
    found = axis_run.axis(rehearsed()[0], stop=90, every=2, radius=55.2).numbers
    assert found["column"] == pytest.approx(98.3, abs=0.1)


@pytest.mark.parametrize("camera,tolerance", [(False, 0.001), (True, 0.004)])
def test_gray_finds_what_turning_mirrors_and_leaks_leave(camera: bool, tolerance: float) -> None:
    truth = Optics(leak=0.004, turn=9.0)
    stand, _ = rehearsed(truth=truth)
    found = gray_run.gray(stand, gray_run.levels(15), camera=camera)
    light = np.array([truth.gray(level, 3760) for level in found.tables["gray"]["levels"]])
    measured = np.array(found.tables["gray"]["intensity"])
    assert np.abs(measured - light / light[-1]).max() < tolerance
    linear = 0.004 + 0.996 * np.array(found.tables["gray"]["levels"]) / 255.0
    assert np.abs(light / light[-1] - linear).max() > 2 * tolerance, "the truth is not what nobody need measure"
    assert abs(found.numbers["drift"][0]) < 0.001


def test_gray_of_two_projectors_lights_each_by_its_own_channel() -> None:
    stand, emulated = rehearsed(parse_rig(TWO))
    found = gray_run.gray(stand, gray_run.levels(85))
    assert set(found.tables) == {"gray", "gray_1"} and len(found.numbers["black"]) == 2
    lit = {channels for _, _, channels, _ in emulated.box.intervals}
    assert lit == {1, 2}


def test_mtf_is_that_of_blur_mirrors_and_pixels() -> None:
    truth = Optics(seed=5)
    stand, _ = rehearsed(truth=truth)
    found = mtf_run.mtf(stand)
    frequency = found.readings["frequency"]
    assert found.numbers["positions_mm"] == pytest.approx([-15.0, -6.0, 0.0, 6.0, 15.0])
    for number, place in enumerate(found.numbers["positions_mm"]):
        wanted = truth.modulation(frequency, place, 0.0, 0.0078)
        fine = np.linspace(0.0, 60.0, 60001)
        half = fine[np.argmax(truth.modulation(fine, place, 0.0, 0.0078) < 0.5)]
        assert found.numbers["mtf50_per_mm"][number] == pytest.approx(half, rel=0.02)
        assert np.abs(found.readings["modulation"][number] - wanted).max() < 0.04


def test_a_saved_mtf_is_the_point_spread_of_a_beam(tmp_path: Path) -> None:
    truth = Optics(seed=5)
    place = save(mtf_run.mtf(rehearsed(truth=truth)[0], (-6.0, 0.0, 6.0)), tmp_path / "mtf", EMULATED)
    for position in (-6.0, 0.0, 6.0):
        found = PointSpread.load(place, truth.pitch, at=position)
        assert found.width == pytest.approx(truth.blur(position, 0.0), rel=0.015)
    assert Beam((4, 4), truth.pitch, spread=found).spread == found.width


@pytest.mark.slow
def test_mtf_follows_a_focus_that_was_calibrated(tmp_path: Path) -> None:
    place = save(small_focus(rehearsed()[0]), tmp_path / "focus", EMULATED)
    powers = focused_at(place, (-10.0, 10.0))
    found = mtf_run.mtf(rehearsed()[0], (-10.0, 10.0), powers=powers).numbers
    assert np.array(found["powers_dpt"]) == pytest.approx(np.array(powers), abs=0.0026), "a lens takes whole codes"
    assert min(found["mtf50_per_mm"]) > 12.0 and found["blur_mm"][0] == pytest.approx(0.0145, abs=0.001)


def test_results_are_read_back(tmp_path: Path) -> None:
    found = gray_run.gray(rehearsed()[0], gray_run.levels(51))
    place = save(found, tmp_path / "gray", EMULATED)
    data = read(place, "gray")
    assert data["measured"]["black"] == found.numbers["black"]
    assert data["gray"] == found.tables["gray"]
    assert GrayCurve.load(place / "result.toml").levels == gray_run.levels(51)
    with np.load(place / "readings.npz") as arrays:
        assert np.array_equal(arrays["readings_0"], found.readings["readings_0"])
    assert (place / "figure.png").read_bytes()[:4] == b"\x89PNG" and (place / "rig.toml").read_text() == EMULATED
    with pytest.raises(StorageError, match="exists"):
        save(found, place, EMULATED)
    with pytest.raises(BadInput, match="expected one of focus"):
        read(place, "focus")
    with pytest.raises(StorageError, match="check the path"):
        read(tmp_path / "nothing")


def test_a_rehearsal_repeats_exactly() -> None:
    one, two = (gray_run.gray(rehearsed()[0], gray_run.levels(85)).readings["readings_0"] for _ in range(2))
    assert np.array_equal(one, two)


# ---- what cannot be measured is told, and dark ---------------------------------------------------------------------
@pytest.mark.parametrize(
    "truth,run,why",
    [
        (replace(Optics(), electrons=4e7), small_focus, "saturated"),
        (replace(Optics(), electrons=0.0), small_focus, "position -2 mm: .*(peak|sharp)"),
        (replace(Optics(), middle=30.0), small_focus, "position -2 mm"),
        (replace(Optics(), full=0.01), axis_run.axis, "deeper than the noise"),
        (replace(Optics(), radius=300.0), axis_run.axis, "deeper than the noise"),
        (replace(Optics(), full=0.0), lambda stand: gray_run.gray(stand, gray_run.levels(51)), "light the meter"),
        (replace(Optics(), electrons=0.0), mtf_run.mtf, "position -15 mm: .*expected an edge"),
    ],
)
def test_too_much_or_too_little_light_is_told_in_the_dark(
    truth: Optics, run: Callable[[CalibrationMachines], CalibrationResult], why: str
) -> None:
    stand, emulated = rehearsed(truth=truth)
    with pytest.raises(BadInput, match=why):
        run(stand)
    assert not emulated.box.light and not emulated.box.armed


def test_tables_that_are_missing_are_named() -> None:
    for table, run in (("camera", focus_run), ("camera_stage", mtf_run), ("photodiode", axis_run), ("lens", focus_run)):
        feedback = f'[[feedback]]\ndriver = "emulated {table}"\n'
        cut = EMULATED.index(feedback if feedback in EMULATED else f"[{table}]\n")
        end = EMULATED.find("\n[", cut)
        rig = parse_rig(EMULATED[:cut] + (EMULATED[end + 1 :] if end >= 0 else ""))
        for begin in (rehearsal, opened):
            with pytest.raises(JobError, match=rf"the rig has no {table.replace('_', ' ')}.*add \["):
                begin(rig, run.TABLES)
    with pytest.raises(JobError, match="pixel"):
        mtf_run.mtf(rehearsed(parse_rig(EMULATED.replace('pixel = "7.8 um"\n', "")))[0])


def test_real_rigs_open_real_machines_or_none(tmp_path: Path) -> None:
    text = '[rig]\nname = "lab"\nmachine = "web"\n[motion]\nmicrosteps = 80.0\n'
    text += '[controller]\ndriver = "vam-controller"\nport = "/dev/none"\n'
    text += '[display]\ndriver = "alp"\nlibrary = "/none.so"\n'
    camera = '[[feedback]]\ndriver = "camera"\nproducer = "/none.cti"\n'
    with pytest.raises(DeviceNotFound, match="/dev/none"):
        opened(parse_rig(text + camera), ("camera",))
    with pytest.raises(JobError, match="producer"):
        parse_rig(text + '[[feedback]]\ndriver = "camera"\n')
    with pytest.raises(JobError, match="port"):
        parse_rig(text + '[[feedback]]\ndriver = "photodiode"\n')
    with pytest.raises(JobError, match="feedback: is emulated and controller is real"):
        parse_rig(text + '[[feedback]]\ndriver = "emulated photodiode"\n')


def test_opened_machines_measure_in_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that is not mirrors is behind a true port, and time is the computer's."""
    array = ArrayModel(height=8, width=64)
    alp, box, glass, axis = EmulatedAlp(VirtualClock(), array), EmulatedController(), EmulatedLens(), EmulatedStage()
    shown: list[int] = []
    put = alp._planes

    def kept(data: np.ndarray, stored: Stored) -> np.ndarray:
        planes = put(data, stored)
        shown.append(int(np.packbits(planes[:, 0, 0] >> 7)[0]))
        return planes

    alp._planes = kept
    meter = EmulatedMeter(lambda now: 0.1 + bool(box.light) * (shown[-1] if shown else 0) / 255.0, 0.0005)
    monkeypatch.setattr("vamgpu.hosts.drivers.alp.load", lambda path: alp.library)
    with PtyServer(box) as a, PtyServer(glass) as b, TcpServer(axis) as c, PtyServer(meter) as d:
        text = f"""
[rig]\nname = "lab"\nmachine = "web"
[motion]\nmicrosteps = 80.0\n[controller]\ndriver = "vam-controller"\nport = "{a.url}"
[display]\ndriver = "alp"\nlibrary = "there.so"\nsize = [8, 64]
[lens]\ndriver = "optotune"\nport = "{b.url}"
[camera_stage]\ndriver = "zaber"\nport = "{c.url}"\nmicrosteps = 5000.0\nmiddle = "1 mm"\nspeed = "20 mm/s"
[[feedback]]\ndriver = "photodiode"\nport = "{d.url}"\nwavelength = 405.0\naverage = 3\nsettle = "10 ms"
"""
        stand = opened(parse_rig(text), ("lens", "camera_stage", "photodiode"))
        try:
            assert stand.move(0.25) == 0.25
            found = gray_run.gray(stand, gray_run.levels(51), repeats=2)
        finally:
            stand.close()
    assert np.array(found.tables["gray"]["intensity"]) == pytest.approx(np.arange(0, 256, 51) / 255.0, abs=0.01)
    assert meter.wavelength == 405.0 and meter.count == 3 and glass.holds
    assert not box.light and not box.armed and not alp.allocated


def test_an_opened_enclosure_ends_it_dark() -> None:
    stand, emulated = rehearsed()

    def open_at_half(share: float) -> None:
        if share >= 0.5:
            emulated.box.open_interlock(emulated.clock.now())

    with pytest.raises(InterlockOpen, match="interlock"):
        gray_run.gray(stand, gray_run.levels(15), progress=open_at_half)
    assert not emulated.box.light and not emulated.box.armed


def test_any_exception_is_dark_first() -> None:
    stand, emulated = rehearsed()

    def fail(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mtf_run.mtf(stand, (0.0,), progress=fail)
    assert not emulated.box.light and not emulated.box.armed


def test_a_hang_of_the_camera_leaves_no_light() -> None:
    stand, emulated = rehearsed()
    grab = stand.camera.grab  # type: ignore[union-attr]

    def slow() -> np.ndarray:
        emulated.clock.sleep(400_000_000)
        return grab()

    stand.camera.grab = slow  # type: ignore[union-attr]
    with pytest.raises(InterlockOpen, match="lease"):
        mtf_run.mtf(stand, (0.0,))
    (start, end, *_), *_ = emulated.box.intervals
    assert end - start <= 250_000_000 + 50_000_000 and not emulated.box.light


def test_the_stage_moves_in_the_dark_alone() -> None:
    stand, emulated = rehearsed()
    mtf_run.mtf(stand)
    lit = [(start, end) for start, end, *_ in emulated.box.intervals]
    assert len(lit) == 5
    for start, end in lit:
        assert emulated.axis.track.position(start) == emulated.axis.track.position(end)


def test_what_a_rig_cannot_do_is_told() -> None:
    stand, _ = rehearsed()
    with pytest.raises(BadInput, match="the limits of the rig"):
        focus_run.focus(stand, (0.0, 1.0), (9.0, 9.5))
    with pytest.raises(BadInput, match="projector 1"):
        axis_run.axis(stand, projector=1)
    scan: dict[str, Any]
    for scan in ({"every": 0}, {"repeats": 0}, {"first": 9, "stop": 9}, {"stop": 4000}):
        with pytest.raises(BadInput, match="a scan of columns"):
            axis_run.axis(stand, **scan)
    with pytest.raises(BadInput, match="2 or more"):
        gray_run.gray(stand, gray_run.levels(85), repeats=1)
    for wrong in (lambda: gray_run.levels(0), lambda: focus_run.steps(1.0, 0.0), lambda: focus_run.sweep(1.0, 0.0, 9)):
        with pytest.raises(BadInput, match="expected"):
            wrong()
    with pytest.raises(BadInput, match="expose shorter"):
        mtf_run.mtf(rehearsed(parse_rig(EMULATED.replace("5 ms", "200 ms")))[0])
