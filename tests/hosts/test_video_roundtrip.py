"""A vial's frames → video cable → emulated screen → resin: the dose is the library's own, and what is wrong is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.hosts.emulators.rigs import EmulatedVideoRig
from vamgpu.hosts.frames.sources import MirrorArray, VialFrames
from vamgpu.hosts.player.machines import SourceFrames, VideoFrames
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.player.video import SpinningPlayer
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.video import vial
from vamgpu.operators.projection import Projection
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve


class Shifted:
    """Frames that come one pose late."""

    def __init__(self, frames: VideoFrames, count: int) -> None:
        self._pictures, self._count = frames, count

    def frame(self, number: int) -> np.ndarray | None:
        return self._pictures.frame((number - 1) % self._count)


def printed(path: Path, emulated: EmulatedVideoRig, frames: VideoFrames, images: int, latency: int) -> np.ndarray:
    """Light [pose, r, z] in shares of full-on, decoded here: the highest z is the top row, the least r the left."""
    (rows, columns), share = emulated.screen.size, emulated.screen.share
    display = HdmiTiming(pixels=(columns, rows), bits=emulated.screen.bits, latency=latency)
    schedule = vial(images, speed=45, display=display, turns=2)
    player = SpinningPlayer(schedule, display, emulated.machines(latency), frames)
    with RunFolder.begin(path, {}, "") as folder:
        assert Print(player, folder).run() is PrintState.COMPLETE
    assert len(read_run(path).shown) == len(schedule)
    seconds = emulated.recorder.seconds(0, images, turn=images)[0]
    shown = seconds[:, 4:12, 8:24]
    assert shown.sum() == pytest.approx(seconds.sum(), rel=1e-12), "no light beside the frames"
    return shown[:, ::-1, :].transpose(0, 2, 1) / (2 * share * 360 / 45 / images)


@pytest.mark.parametrize("bits", [8, pytest.param(7, marks=pytest.mark.slow)])
def test_the_dose_is_the_librarys_own_and_a_shift_or_a_wrong_turn_is_seen(tmp_path: Path, bits: int) -> None:
    images, size, top = 120, (16, 32), 2**bits - 1
    A = Projection(Grid((16, 16, 8), 0.5), Beam((16, 8), 0.5, spread=0.0), Turntable(images), device="numpy")
    levels = np.random.default_rng(1).integers(0, top + 1, (images, 8, 16))
    bytes_ = ((levels * 255 + top // 2) // top).astype(np.uint8)
    frames = Frames.from_bytes(bytes_, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=16)
    irradiance = np.array(frames.irradiance().numpy())
    if bits < 8:  # the cable carries fewer levels than the job has
        irradiance = (levels / top)[:, ::-1].transpose(0, 2, 1)
    wanted = A.T(A.device.upload(irradiance)).numpy()
    shown = SourceFrames(VialFrames(frames, MirrorArray(*size, row_bytes=4)), size)

    def off(name: str, frames: VideoFrames = shown, told: int = 1, scale: float = 1.0) -> float:
        emulated = EmulatedVideoRig(images, size, bits=bits, share=0.9, scale=scale)
        light = printed(tmp_path / name, emulated, frames, images, told)
        return float(np.abs(A.T(A.device.upload(light)).numpy() - wanted).max() / np.abs(wanted).max())

    assert off("good") < 1e-4
    assert off("shifted", Shifted(shown, images)) > 0.01
    assert off("inverted", scale=-1.0) > 0.01
    assert off("a video frame earlier than told", told=2) > 0.01
