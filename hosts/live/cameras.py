"""The monitoring camera of a rig: as it was measured, as its file describes it, or as it is given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.live.needs import KIND
from vamgpu.hosts.rigs.calibrations import MEASURED, Calibration, in_force, measured
from vamgpu.hosts.rigs.planning import PrintPlan
from vamgpu.live import CuringResin, SensorNoise, Turbidity
from vamgpu.live.sensor import BeamImages, SensorView
from vamgpu.optics.vial import Vial
from vamgpu.storage.numpy_files import read_npz

GUESSED = 0.2  # relative error of a turbidity that was not measured
DIGITS = 2  # of the open field in a run's record [gray levels]


@dataclass(frozen=True, eq=False)
class RedCamera:
    """The monitoring camera and the model of what it sees.

    Args:
        open_field: Gray level through the vial before the print, less the dark one: a number, or [row, column] of the
            camera's images.
        noise: Noise of the camera's pixels.
        vial: The vial at the wavelength of the camera's light; None takes the job's, without absorption.
        resin: Assumed kinetics.
        turbidity: Assumed turbidity.
        view: Where the camera's images show the mirrors; None if its pixels are those of the beam.
    """

    open_field: Any = 800.0
    noise: SensorNoise = field(default_factory=lambda: SensorNoise(read=0.8, gain=0.01, bits=10))
    vial: Vial | None = None
    resin: CuringResin = field(default_factory=CuringResin)
    turbidity: Turbidity = field(default_factory=lambda: Turbidity((0.0, 1.0), (0.0, 0.25)))
    view: SensorView | None = None

    def on_beam(self, planned: PrintPlan, pixels: tuple[int, int]) -> tuple[Any, SensorNoise, SensorView | None]:
        """Open field, noise and place of images on the pixels of a job's beam (columns, rows). Raises `BadInput`."""
        frames, columns, rows = planned.jobs[0].frames, *pixels
        if self.view is None or frames is None:
            return self.open_field, self.noise, None
        corner = tuple(each.start for each in planned.mirrors[0].place(rows, columns))
        view = self.view.of_beam(frames.settings, pixels, (corner[0], corner[1]))
        images = BeamImages(view, pixels)
        whole = np.broadcast_to(np.asarray(self.open_field, np.float32), view.shape)
        seen = np.nan_to_num(images(whole + view.dark))
        return np.round(seen.astype(float), DIGITS).tolist(), images.noise(self.noise), view


def camera_of(planned: PrintPlan, given: RedCamera | None, pitch: float) -> RedCamera:
    """The camera given, or that of the rig. pitch: of the beam [mm]. Raises `BadInput`, `JobError`, `StorageError`."""
    if given is not None:
        if not isinstance(given, RedCamera):
            raise BadInput(f"camera is {given!r}; expected a RedCamera")
        return given
    config, section = planned.rig, planned.rig.setup.camera
    if KIND in in_force(config) or not planned.rehearsed:
        return _measured(measured(config, KIND))
    usual, mirrors = RedCamera(), planned.mirrors[0]
    if section is None or section.crop is None or section.pixel is None:
        return usual  # an emulated camera whose pixels are those of the beam
    view = SensorView.described(
        (section.crop[3], section.crop[2]), (mirrors.rows, mirrors.columns), pitch / section.pixel, flip=section.flip,
        rotation=section.rotation, bits=section.bits,
    )  # fmt: skip
    share = (2**section.bits - 1) / usual.noise.brightest
    noise = SensorNoise(usual.noise.read, share * usual.noise.gain, section.bits)
    return replace(usual, view=view, noise=noise, open_field=share * usual.open_field)


def _measured(found: Calibration) -> RedCamera:
    numbers = found.tables()[MEASURED]
    try:
        shape, bits = (numbers["rows"], numbers["columns"]), numbers["bits"]
        view = SensorView(shape, numbers["matrix"], numbers["origin"], numbers["dark"], bits)
        noise = SensorNoise(numbers["read"], numbers["gain"], bits)
    except (KeyError, TypeError, ValueError) as error:
        raise StorageError(f"{str(found.path)!r} is malformed ({error}); run vam calibrate live again") from error
    open_field = read_npz(found.path / "readings.npz").get("open_field")
    if open_field is None or open_field.shape != view.shape:
        raise StorageError(f"{str(found.path)!r} has no open field of {view.shape}; run vam calibrate live again")
    camera = RedCamera(open_field, noise, view=view)
    full = numbers.get("turbidity")
    if full is None:
        return replace(camera, turbidity=replace(camera.turbidity, error=GUESSED))
    error = float(numbers["turbidity_error"]) / float(full)
    return replace(camera, turbidity=Turbidity((0.0, 1.0), (0.0, float(full)), error=error))


def unmeasured(planned: PrintPlan) -> str:
    """Unmeasured properties of the camera that a print on real machines assumes; empty if there are none."""
    found = in_force(planned.rig).get(KIND)
    if planned.rehearsed or found is None or "turbidity" in found.tables()[MEASURED]:
        return ""
    return ("the turbidity of cured resin is a guess: after this print in fresh resin, measure it with vam calibrate "
            "live --keep-place --cured and its run folder")  # fmt: skip
