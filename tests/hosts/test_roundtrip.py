"""Frames → drivers → emulated machines → resin: the dose is the library's own, and a shift or a wrong turn is seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.frames.sources import FrameSource, MirrorArray, VialFrames, WebFrames
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.schedules.limits import LensTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.operators.projection import Projection
from vamgpu.operators.web import WebProjection
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.printing.focus import FocusMasks, split
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.web import WebGrid

MODEL = ArrayModel(height=24, width=64)
MIRRORS = MirrorArray(24, 64, 8)
TIMING = MirrorTiming(pixels=(64, 24), row_bytes=8, dark=3e-3)
STEPS = 1000
"""Microsteps of the motion in a pose."""


class Shifted:
    """Pictures that come one slot late."""

    def __init__(self, source: Any) -> None:
        self._source, self.bits = source, source.bits

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        return self._source.planes((np.asarray(numbers) - 1) % self._source.count)

    def frame(self, number: int) -> np.ndarray:
        return self._source.frame(number)


def frames_of(bytes_: np.ndarray, bits: int = 8) -> Frames:
    fields: dict[str, Any] = {"bits": bits, "gray": GrayCurve.linear(), "scale": 1.0, "columns": bytes_.shape[2]}
    return Frames.from_bytes(bytes_ if bits == 8 else np.packbits(bytes_ > 127, axis=-1), "numpy", **fields)


def printed(path: Path, schedule: Schedule, sources: list[Any], powers: tuple[float, ...] = ()) -> EmulatedMirrorRig:
    emulated = EmulatedMirrorRig(STEPS, MODEL, schedule.engines, powers)
    machines = emulated.machines(STEPS / float(schedule.advance))
    with RunFolder.begin(path, {}, "") as folder:
        assert Print(TriggeredPlayer(schedule, machines, sources), folder).run() is PrintState.COMPLETE
    run = read_run(path)
    assert run.state is PrintState.COMPLETE and not run.shown["dark"].any()
    assert len(run.shown) == len(schedule) * schedule.engines
    return emulated


def seen(seconds: np.ndarray, schedule: Schedule, shape: tuple[int, ...]) -> np.ndarray:
    """Light [pose, r, z] in shares of full-on, decoded here: the highest z is the top row, the least r the left."""
    rows, columns = shape[1:]
    top, left = (MIRRORS.rows - rows) // 2, (MIRRORS.columns - columns) // 2
    cut = seconds[:, top : top + rows, left : left + columns]
    assert cut.sum() == pytest.approx(seconds.sum(), rel=1e-12), "no light beside the pictures"
    return cut[:, ::-1, :].transpose(0, 2, 1) / (int(schedule.on[0]) * 1e-9)


def off(got: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.abs(got - wanted).max() / np.abs(wanted).max())


@pytest.fixture
def vial() -> tuple[Projection, np.ndarray]:
    beam, chance = Beam((16, 8), 0.5), np.random.default_rng(1)
    A = Projection(Grid((16, 16, 8), 0.5), beam, Turntable(40), device="numpy")
    return A, chance.integers(0, 256, (40, 8, 16), dtype=np.uint8)


def shone(A: Any, light: np.ndarray) -> np.ndarray:
    return A.T(A.device.upload(light)).numpy()


@pytest.mark.parametrize("bits", [8, 1])
def test_vial(tmp_path: Path, vial: tuple[Projection, np.ndarray], bits: int) -> None:
    A, bytes_ = vial
    frames = frames_of(bytes_, bits)
    schedule = turned(40, speed=40, engines=TIMING, turns=2, bits=bits)
    wanted = A.T(frames.irradiance()).numpy()
    source = VialFrames(frames, MIRRORS)
    emulated = printed(tmp_path / "run", schedule, [source])
    light = seen(emulated.recorder.seconds(0, 40, turn=40)[0], schedule, frames.shape)
    assert off(shone(A, light) / 2, wanted) < 1e-4
    inverted = light[-np.arange(40)]
    assert off(shone(A, inverted) / 2, wanted) > 0.01
    shifted = printed(tmp_path / "shifted", schedule, [Shifted(source)])
    light = seen(shifted.recorder.seconds(0, 40, turn=40)[0], schedule, frames.shape)
    assert off(shone(A, light) / 2, wanted) > 0.01


def test_a_stage_that_turns_the_other_way_is_seen(tmp_path: Path, vial: tuple[Projection, np.ndarray]) -> None:
    A, bytes_ = vial
    frames = frames_of(bytes_)
    schedule = turned(40, speed=40, engines=TIMING)
    emulated = EmulatedMirrorRig(STEPS, MODEL)
    emulated.recorder._position = lambda now: -emulated.controller.web.position(now) / STEPS
    machines = emulated.machines(STEPS / float(schedule.advance))
    with RunFolder.begin(tmp_path / "run", {}, "") as folder:
        Print(TriggeredPlayer(schedule, machines, [VialFrames(frames, MIRRORS)]), folder).run()
    light = seen(emulated.recorder.seconds(0, 40, turn=40)[0], schedule, frames.shape)
    assert off(shone(A, light), A.T(frames.irradiance()).numpy()) > 0.01


def test_dual_color(tmp_path: Path, vial: tuple[Projection, np.ndarray]) -> None:
    """Two projectors in step: each color's dose is its own, at its own bytes."""
    A, bytes_ = vial
    colors = [frames_of(bytes_), frames_of(np.random.default_rng(2).integers(0, 256, bytes_.shape, dtype=np.uint8))]
    schedule = turned(40, speed=40, engines=(TIMING, TIMING))
    sources: list[FrameSource] = [VialFrames(each, MIRRORS) for each in colors]
    emulated = printed(tmp_path / "run", schedule, sources)
    doses = []
    for engine, frames in enumerate(colors):
        light = seen(emulated.recorder.seconds(engine, 40, turn=40)[0], schedule, frames.shape)
        doses.append(shone(A, light))
        assert off(doses[-1], A.T(frames.irradiance()).numpy()) < 1e-4
    assert off(doses[0], doses[1]) > 0.01


def roller() -> tuple[Roller, Beam, FocusMasks]:
    machine = Roller(3.0, Film(1.0, 1.49, 1.33, 0.2), np.radians(3.0))
    beam = machine.beam(0.25, 4)
    return machine, beam, FocusMasks.around(beam, 3.0, 1.0, 3)


@pytest.fixture
def film() -> tuple[WebProjection, FocusMasks, np.ndarray, float]:
    machine, beam, masks = roller()
    edges = (machine.advance, 0.25, 0.25)
    A = WebProjection(WebGrid((40, 4, 4), edges), beam, machine, "numpy")
    shape = (A.motion.poses, beam.pixels[1], beam.pixels[0])
    return A, masks, np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8), machine.advance


@pytest.mark.slow
def test_web_with_three_depth_bins(tmp_path: Path, film: tuple[WebProjection, FocusMasks, np.ndarray, float]) -> None:
    A, masks, bytes_, advance = film
    frames, powers = frames_of(bytes_), (0.0, 0.7, 1.4)
    lens = LensTiming(settle=6e-3, latency=1e-3)
    options: dict[str, Any] = {"advance": advance, "speed": 0.8, "engines": TIMING, "lens": lens, "focus": powers}
    schedule = web(len(bytes_), **options)
    source = WebFrames(lambda low, high: bytes_[low:high], len(bytes_), MIRRORS, masks)
    emulated = printed(tmp_path / "run", schedule, [source], powers)
    assert emulated.recorder.astray == 0.0, "no light while the lens moves"
    seconds = emulated.recorder.seconds(0, len(bytes_))
    parts = [seen(plane, schedule, frames.shape) for plane in seconds]
    for part, wanted in zip(parts, split(frames, masks), strict=True):
        assert off(part, wanted.irradiance().numpy()) < 1e-4, "every column through its own focus"
    wanted = A.T(frames.irradiance()).numpy()
    assert off(shone(A, np.sum(parts, axis=0)), wanted) < 1e-4
    shifted = printed(tmp_path / "shifted", schedule, [Shifted(source)], powers)
    light = np.sum([seen(plane, schedule, frames.shape) for plane in shifted.recorder.seconds(0, len(bytes_))], axis=0)
    assert off(shone(A, light), wanted) > 0.01


def test_a_lens_that_settles_slower_than_told_is_seen(
    tmp_path: Path, film: tuple[WebProjection, FocusMasks, np.ndarray, float]
) -> None:
    _, masks, bytes_, advance = film
    bytes_ = bytes_[:20]
    lens = LensTiming(settle=1e-3)
    options: dict[str, Any] = {"advance": advance, "speed": 0.8, "engines": TIMING, "lens": lens}
    schedule = web(len(bytes_), focus=(0.0, 0.7, 1.4), **options)
    source = WebFrames(lambda low, high: bytes_[low:high], len(bytes_), MIRRORS, masks)
    emulated = printed(tmp_path / "run", schedule, [source], (0.0, 0.7, 1.4))
    assert emulated.recorder.astray > 0.0
