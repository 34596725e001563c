"""Webs, two colors, slices and video vials on rigs: planned, rehearsed with every byte in its place, or refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.curethrough.images import encode
from vamgpu.curethrough.output import RECORD
from vamgpu.errors import BadInput, JobError, SliceError, StorageError, TimingInfeasible, VamError
from vamgpu.hosts.frames.packer import DevicePacker, packer
from vamgpu.hosts.frames.sources import MirrorArray, WebFrames
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.player.video import STEP
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import Rehearsal, carry_out, player, rehearsal
from vamgpu.hosts.rigs.config import RigConfig, parse_rig, read_rig
from vamgpu.hosts.rigs.planning import PrintPlan, plan
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.printing.focus import FocusMasks
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.webs.describe import described, described_focus
from vamgpu.webs.store import WebFolder

ROLLER = Roller(3.0, Film(1.0, 1.49, 1.33, 0.2), float(np.radians(3.0)))
BEAM = ROLLER.beam(0.25, 6)
MASKS = FocusMasks.around(BEAM, 3.0, 1.0, 3)
POSES = 90

ALP = """
[rig]
name = "lab"
machine = "any"
[controller]
port = "/dev/ttyACM0"
[motion]
driver = "controller"
microsteps = 3200.0
[[display]]
driver = "alp"
library = "libalpD43.so"
"""
HDMI = """
[rig]
name = "lightcrafter"
machine = "vial"
[controller]
driver = "vam-controller"
port = "/dev/ttyACM0"
[display]
driver = "video"
size = [8, 12]
[motion]
driver = "zaber"
port = "/dev/ttyUSB0"
"""
LENS = """
[lens]
driver = "optotune"
port = "/dev/ttyUSB1"
"""


def vial(path: Path, seed: int = 4, images: int = 36, bits: int = 8) -> Path:
    levels = np.random.default_rng(seed).integers(0, 256, (images, 6, 10), dtype=np.uint8)
    bytes_ = levels if bits == 8 else np.packbits(levels > 127, axis=-1)
    frames = Frames.from_bytes(bytes_, "numpy", bits=bits, gray=GrayCurve.linear(), scale=1.0, columns=10)
    return save_frames(path, frames).path


def web(
    path: Path, masks: FocusMasks | None = MASKS, poses: int = POSES, complete: bool = True, speed: float | None = None
) -> Path:
    """A web of two segments, whose frames are of chance."""
    columns, rows = BEAM.pixels
    details = {
        "grid": {"section": [4, 6], "pitch": [ROLLER.advance, 0.25, 0.25]},
        "beam": {"pixels": [columns, rows], "pitch": BEAM.pitch},
        "wrap": described(ROLLER),
        "frames": {"bits": 8, "gray": GrayCurve.linear().describe(), "scale": 1.0, "focus": described_focus(masks)},
        "speed": speed,
    }
    folder = WebFolder.create(path, details, (rows, columns), (4, 6), (poses // 2, 4))
    images = np.random.default_rng(6).integers(0, 256, (poses, rows, columns), dtype=np.uint8)
    for half in (0, 1):
        part = images[half * poses // 2 : (half + 1) * poses // 2]
        folder = folder.append(part, np.full((4, 4, 6), 255, np.uint8), (1.0, 0.5), 0, complete and half == 1)
    return folder.path


def slices(path: Path, **machine: float) -> Path:
    path.mkdir()
    levels = np.random.default_rng(7).integers(0, 256, (20, 5, 9), dtype=np.uint8)
    for number, frame in enumerate(levels):
        (path / f"slice_{number:03d}.png").write_bytes(encode(frame, ".png"))
    (path / RECORD).write_text(json.dumps({"machine": machine}))
    return path


CONTINUOUS = {"slice_height": 0.05, "speed": 1000 / 3600}


def rehearsed(path: Path, planned: PrintPlan, greatest: float = 1e-6) -> Rehearsal:
    """A rehearsal that shows every byte in its place."""
    stand = rehearsal(planned)
    assert carry_out(planned, stand.machines, path)[0] is PrintState.COMPLETE
    shown = read_run(path).shown
    assert len(shown) == len(planned.schedule) * planned.schedule.engines and not shown["dark"].any()
    verdict = stand.monitor.verdict()
    assert verdict.frames == planned.schedule.frames * len(planned.jobs)
    assert verdict.greatest < greatest and verdict.beside < 1e-9, verdict
    return stand


def test_a_web_is_cut_among_its_focus_planes(tmp_path: Path) -> None:
    planned = plan(web(tmp_path / "web.vam"), read_rig("emulated"), speed=0.8)
    assert planned.kind == "web" and len(planned.schedule) == 3 * POSES and len(planned.focus) == 3
    slope = np.diff(MASKS.planes) / np.diff(planned.focus)
    assert slope == pytest.approx(-1.33 * 200.0**2 * 1e-3, rel=1e-3), "of the relays, in the bath"
    stand = rehearsed(tmp_path / "run", planned)
    assert len(stand.emulated.recorder.light) <= 3, "poses that are over are forgotten"
    assert dict(planned.lines())["focus planes"].startswith("3 at ")


def test_a_web_that_was_moved_knows_its_speed(tmp_path: Path) -> None:
    made = web(tmp_path / "web.vam", speed=0.9)
    moved = made.rename(tmp_path / "other name")
    assert float(plan(moved, read_rig("emulated")).schedule.speed) == pytest.approx(0.9)
    with pytest.raises(BadInput, match="has no speed"):
        plan(web(tmp_path / "silent.vam"), read_rig("emulated"))


def test_a_web_of_one_focus_wants_no_lens(tmp_path: Path) -> None:
    planned = plan(web(tmp_path / "web.vam", None), parse_rig(ALP), speed="48 mm/min", rehearsed=True)
    assert planned.focus == () and float(planned.schedule.speed) == pytest.approx(0.8)
    rehearsed(tmp_path / "run", planned)


def test_a_lens_that_the_host_controls_has_one_focus(tmp_path: Path) -> None:
    told = parse_rig(ALP + LENS + 'controlled_by = "host"\n')
    with pytest.raises(BadInput, match="among 3 planes in time with its frames"):
        plan(web(tmp_path / "web.vam"), told, speed=0.8)
    planned = plan(web(tmp_path / "one.vam", None), told, speed=0.8)
    bare = plan(tmp_path / "one.vam", parse_rig(ALP), speed=0.8)
    assert len(planned.focus) <= 1 and (planned.schedule.on == bare.schedule.on).all(), "no time for its settling"


class Shifted:
    """Frames as they would be one slot later."""

    def __init__(self, frames: Any) -> None:
        self._sources = frames

    def levels(self, numbers: np.ndarray) -> np.ndarray:
        return self._sources.levels(np.maximum(numbers - 1, 0))


@pytest.mark.parametrize("make", [vial, web])
def test_a_shift_by_one_slot_is_seen(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    planned = plan(make(tmp_path / "job.vam"), read_rig("emulated"), speed=0.8 if make is web else 40, turns=1)
    stand = rehearsal(planned)
    stand.monitor._sources = tuple(map(Shifted, stand.monitor._sources))
    carry_out(planned, stand.machines, tmp_path / "run")
    assert stand.monitor.verdict().greatest > 0.5


def test_webs_are_the_same_bytes_from_the_device_and_the_host(tmp_path: Path, processor: str) -> None:
    from vamgpu.backend import open_device

    folder = WebFolder.open(web(tmp_path / "web.vam"))
    mirrors, numbers = MirrorArray(8, 128, 16), np.array([7, NONE, 131, 132, 269, 0])
    asked: list[int] = []

    def read(low: int, high: int) -> np.ndarray:
        asked.append(high - low)
        return folder.read("frames", low, high)

    shape = (8, 8, 16)
    host = packer(WebFrames(read, POSES, mirrors, MASKS), shape, 3 * POSES, 8)
    assert not isinstance(host, DevicePacker)
    one, outs = np.full((8, *shape), 9, np.uint8), []
    host.read(numbers, one)
    for name in ("numpy", processor):
        made = packer(WebFrames(read, POSES, mirrors, MASKS, open_device(name)), shape, 3 * POSES, 8)
        assert isinstance(made, DevicePacker)
        outs.append(np.full((8, *shape), 9, np.uint8))
        made.read(numbers, outs[-1])
    assert np.array_equal(one, outs[0]) and np.array_equal(one, outs[1])
    assert not one[1].any() and not one[6:].any() and one[2].any()
    assert max(asked) <= 2, "no more is read than a batch shows, in runs"


def test_two_colors_are_printed_in_step(tmp_path: Path) -> None:
    jobs = vial(tmp_path / "visible.vam", 1), vial(tmp_path / "uv.vam", 2)
    planned = plan(jobs, read_rig("emulated"), turns=2)
    assert planned.schedule.engines == 2 and len(planned.schedule) == 72
    stand = rehearsed(tmp_path / "run", planned)
    for engine in (0, 1):
        frames = planned.jobs[engine].frames
        assert frames is not None
        assert np.array_equal(stand.seen(planned, engine).images.numpy(), frames.images.numpy())


def test_slices_go_by_as_fast_as_they_were_corrected_for(tmp_path: Path) -> None:
    planned = plan(slices(tmp_path / "cone-corrected", **CONTINUOUS), read_rig("emulated"))
    assert planned.kind == "slices" and float(planned.schedule.speed) * 3600 == pytest.approx(1000)
    assert planned.schedule.position[-1] == pytest.approx(19 * 0.05)
    assert "1000 mm/h" in dict(planned.lines())["duration"]
    rehearsed(tmp_path / "run", planned)
    slower = plan(tmp_path / "cone-corrected", read_rig("emulated"), speed=500)
    assert float(slower.schedule.speed) * 3600 == pytest.approx(500)


def test_a_vial_before_a_video_projector(tmp_path: Path) -> None:
    planned = plan(vial(tmp_path / "part.vam", images=60), parse_rig(HDMI), rehearsed=True, turns=1)
    assert planned.display is not None and (planned.schedule.unit, len(planned.schedule)) == ("deg", 60)
    stand = rehearsal(planned)
    assert carry_out(planned, stand.machines, tmp_path / "run")[0] is PrintState.COMPLETE
    verdict = stand.monitor.verdict()
    assert verdict.frames == 60 and verdict.greatest < STEP / 3, "as far as the stage is in step with the cable"


def test_one_bit(tmp_path: Path) -> None:
    rehearsed(tmp_path / "run", plan(vial(tmp_path / "part.vam", bits=1), read_rig("emulated"), turns=1))


def test_another_host_goes_on_where_one_died(tmp_path: Path) -> None:
    planned, place = plan(web(tmp_path / "web.vam"), read_rig("emulated"), speed=0.8), tmp_path / "run"
    stand = rehearsal(planned)
    asked = {"kind": "web", "slots": 270, "speed": float(planned.schedule.speed)}
    with RunFolder.begin(place, asked, planned.rig.text) as folder:
        begun = Print(player(planned, stand.machines), folder)
        begun.guard.__enter__()
        begun.begin(0)
        while begun.next < 40:
            begun.player.wait()
            assert begun.step()
        begun.guard._release_process()  # the host is gone: nobody leaves the guard
    stand.emulated.clock.sleep(SECOND)
    stand.emulated.alps[0].disconnect()
    again = stand.emulated.machines(stand.emulated.microsteps / float(planned.schedule.advance))
    other = plan(tmp_path / "web.vam", read_rig("emulated"), speed=0.7)
    with pytest.raises(BadInput, match="another print, with speed"):
        carry_out(other, again, place, resume=True)
    assert carry_out(planned, again, place, resume=True)[0] is PrintState.INCOMPLETE, "its last frames are in doubt"
    assert read_run(place).shown["slot"].tolist() == list(range(270))
    verdict = stand.monitor.verdict()
    assert verdict.frames == 270 and verdict.beside < 1e-9, "every frame through its own focus"


def lab(text: str = ALP, **changes: str) -> RigConfig:
    for old, new in changes.items():
        text = text.replace(f'{old} = "any"', f'{old} = "{new}"')
    return parse_rig(text)


def test_jobs_that_do_not_fit_the_rig_are_told(tmp_path: Path) -> None:
    part, film = vial(tmp_path / "part.vam"), web(tmp_path / "web.vam")
    cone = slices(tmp_path / "cone", **CONTINUOUS)
    again = vial(tmp_path / "again.vam", images=40)
    dual = lab(ALP + '[[display]]\ndriver = "alp"\nlibrary = "libalpD43.so"\nserial = 7\n')
    cases: tuple[tuple[Any, RigConfig, dict[str, Any], type[VamError], str], ...] = (
        (film, lab(machine="vial"), {"speed": 0.8}, BadInput, "prints vials, .* is for webs"),
        (part, lab(machine="slices"), {}, BadInput, "prints slices"),
        (part, dual, {}, BadInput, "got 1 job for the 2 projectors"),
        ((part, part), lab(), {}, BadInput, "got 2 jobs for the 1 projector of"),
        ((part, again), dual, {}, BadInput, "number of poses; .* has 36, .* has 40"),
        ((part, film), dual, {"speed": 1}, BadInput, "have the same kind"),
        (film, lab(), {"speed": 0.8}, BadInput, "has no lens"),
        (film, lab(ALP + LENS + "axis = 3.49\n"), {"speed": 0.8}, BadInput, "3.49"),
        (film, lab(ALP + LENS), {}, BadInput, "has no speed"),
        (film, lab(ALP + LENS), {"speed": "8 furlongs"}, BadInput, "furlongs"),
        (film, lab(ALP + LENS), {"speed": 80}, TimingInfeasible, "lens"),
        (film, lab(ALP + LENS), {"speed": 0.8, "turns": 2}, BadInput, "turns is 2"),
        (part, lab(), {"speed": -4}, BadInput, "deg/s"),
        (cone, lab(), {"speed": 1e6}, TimingInfeasible, "mm/s"),
        (tmp_path / "nothing", lab(), {}, StorageError, "is not a job"),
        (part, lab(ALP + "size = [4, 4]\n"), {}, BadInput, "another projector"),
        (film, lab(HDMI), {"speed": 1}, BadInput, "prints vials"),
        (part, lab(HDMI), {"speed": 41}, TimingInfeasible, "whole number"),
    )
    for jobs, rig, options, kind, why in cases:
        with pytest.raises(kind, match=why):
            plan(jobs, rig, device="numpy", **options)


def test_folders_that_cannot_be_printed_are_told(tmp_path: Path) -> None:
    rig = read_rig("emulated")
    with pytest.raises(BadInput, match="not complete"):
        plan(web(tmp_path / "half.vam", complete=False), rig, speed=0.8)
    with pytest.raises(SliceError, match="stops at every layer"):
        plan(slices(tmp_path / "layers", slice_height=0.05, exposure=2.0), rig)
    with pytest.raises(SliceError, match="the height of its slices"):
        plan(slices(tmp_path / "unknown"), rig, speed=100)
    film = web(tmp_path / "garbled.vam")
    record = json.loads((film / "web.json").read_text())
    record["details"]["frames"]["focus"]["bin"][3] = 17
    (film / "web.json").write_text(json.dumps(record))
    with pytest.raises(StorageError, match="has malformed details"):
        plan(film, rig, speed=0.8)


def test_rigs_that_cannot_be_are_told() -> None:
    for text, why in (
        (ALP + 'refresh = "60 Hz"\n', "refresh: unknown key"),
        (ALP + "serail = 3\n", "did you mean 'serial'"),
        (ALP + LENS + "lowest = 9.0\n", "lowest below highest"),
        (HDMI.replace('machine = "vial"', 'machine = "slices"'), "prints vials and webs"),
        (HDMI[: HDMI.index("[motion]")] + "[motion]\nmicrosteps = 80\n", "a stage, whose angle chooses"),
        (HDMI + LENS, "prints with one focus, which the host sets"),
        (HDMI.replace("size = [8, 12]", 'order = ["green", "green"]'), "each of them once"),
        (HDMI.replace("[display]", '[[display]]\ndriver = "video"\n[[display]]'), "one projector"),
        (ALP.replace("[[display]]", "[other]"), "display is missing"),
    ):
        with pytest.raises(JobError, match=why):
            parse_rig(text)


def test_the_command_prints_each_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film, cone = str(web(tmp_path / "web.vam", poses=20)), str(slices(tmp_path / "cone", **CONTINUOUS))
    one, two = str(vial(tmp_path / "one.vam", 1)), str(vial(tmp_path / "two.vam", 2))
    (tmp_path / "cable.toml").write_text(HDMI)
    for jobs in (
        (film, "--rig", "emulated", "--speed", "0.8"), (cone, "--rig", "emulated"),
        (one, two, "--rig", "emulated", "--turns", "1"),
        (one, "--rig", str(tmp_path / "cable.toml"), "--dry-run", "--turns", "1"),
    ):  # fmt: skip
        assert main(["print", *jobs, "--out", str(tmp_path / f"{len(list(tmp_path.iterdir()))}.run")]) == 0
        told = capsys.readouterr().out
        assert "complete: " in told and "frames differ in the resin from the job by" in told
    assert main(["print", film, "--rig", "emulated"]) == 1
    assert "has no speed" in capsys.readouterr().err
    assert main(["print", film, "--rig", "emulated", "--speed", "1", "--resume", str(tmp_path)]) == 1
    assert "a dry run cannot be resumed" in capsys.readouterr().err
