"""A rig calibrated by its own drivers: focus, axis, gray levels and sharpness against the values of its emulators."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.hosts.calibrate import axis as axes_of
from vamgpu.hosts.calibrate import focus as foci
from vamgpu.hosts.calibrate import gray as grays
from vamgpu.hosts.calibrate import mtf as mtfs
from vamgpu.hosts.calibrate.connection import rehearsal
from vamgpu.hosts.calibrate.machines import CalibrationMachines
from vamgpu.hosts.calibrate.report import CalibrationResult
from vamgpu.hosts.emulators.calibration import Optics
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TABLES = ("lens", "camera", "camera_stage", "photodiode")
PICTURE = 3760
"""Time of a picture [us]."""


def measured(
    device: Device,
    quick: bool = False,
    slope: float = -40.6,
    axis: float = 98.3,
    leak: float = 0.01,
    waist: float = 0.0138,
) -> Picture:
    """Emulated optics: ``slope`` [mm/dpt], ``axis`` [columns], ``leak`` of mirrors that are off, ``waist`` [mm]."""
    truth = Optics(slope=slope, axis=axis, leak=leak, turn=9.0, waist=waist)

    def stand() -> CalibrationMachines:
        return rehearsal(read_rig("emulated"), TABLES, truth)[0]

    places = foci.steps(1.0 if quick else 2.5, 1.0 if quick else 0.5)
    focus = foci.focus(stand(), places, foci.sweep(-0.25, 0.25, 11 if quick else 31))
    rolled, leveled = axes_of.axis(stand()), grays.gray(stand(), grays.levels(51 if quick else 5))
    sharp = mtfs.mtf(stand())
    figure, panels = style.sheet("ab;cd", 7.4)
    _focus(panels["a"], focus, truth)
    _axis(panels["b"], rolled)
    gray = _gray(panels["c"], leveled, truth)
    mtf = _mtf(panels["d"], sharp, truth)
    facts = (
        Fact("slope of the focus", focus.numbers["slope_mm_dpt"], "mm/dpt", 4, slope, "emulated lens"),
        Fact("axis of the roller", rolled.numbers["column"], "columns", 5, axis, "emulated roller"),
        Fact("largest error of a gray level, of full", gray, "", 2, 1e-3, bound="≤"),
        Fact("largest error of the modulation", mtf, "", 2, 0.04, bound="≤"),
        Fact("half modulation in focus", sharp.numbers["mtf50_per_mm"][2], "1/mm", 4),
    )
    caption = (
        "A dry run of `vam calibrate`: the drivers of mirrors, lens, camera stage, photodiode and light use their real "
        "protocols, and emulated optics with noise respond. Top left, sharpness of a grating against the lens's power "
        "at each position of the camera; top right, columns lit one after another past a roller, whose shadow has two "
        "edges; bottom left, the light of each gray level, which the mirrors' switching time and leaks make nonlinear; "
        "bottom right, modulation of a slanted edge, compared with that of the blur, mirrors and pixels."
    )
    return Picture(figure, caption, facts, papers=(ROLL_TO_ROLL,))


def _focus(panel: Axes, found: CalibrationResult, truth: Optics) -> None:
    powers, sharpness = found.readings["powers"], found.readings["sharpness"]
    for hue, row in zip(style.HUES, range(0, len(powers), max(len(powers) // 4, 1)), strict=False):
        place = float(found.readings["positions"][row])
        panel.plot(powers[row], sharpness[row], ".-", ms=4, lw=0.8, color=hue, label=f"{place:+g} mm")
        panel.axvline((place - truth.middle) / truth.slope, color=hue, lw=0.8, ls="--")
    panel.set(title="Focus", xlabel="power of the lens [dpt]", ylabel="sharpness")
    panel.legend()


def _axis(panel: Axes, found: CalibrationResult) -> None:
    panel.plot(found.readings["columns"], found.readings["readings"].mean(axis=1), color=style.INK, lw=1.0)
    for edge in found.numbers["edges"]:
        panel.axvline(edge, color=style.ORANGE, lw=1.0)
    panel.axvline(found.numbers["column"], color=style.BLUE)
    panel.set(title="Axis, from both edges of the shadow", xlabel="lit column", ylabel="photodiode [mW]")


def _gray(panel: Axes, found: CalibrationResult, truth: Optics) -> float:
    curve = found.tables["gray"]
    levels, got = np.array(curve["levels"]), np.array(curve["intensity"])
    true = np.array([truth.gray(int(level), PICTURE) for level in levels])
    panel.plot(levels, 100 * (true / true[-1] - levels / 255.0), color=style.FAINT, lw=4, label="truth")
    panel.plot(levels, 100 * (got - levels / 255.0), ".", color=style.BLUE, label="measured")
    panel.set(title="Gray levels, off the straight line", xlabel="level", ylabel="light − level [% of full]")
    panel.legend()
    return float(np.abs(got - true / true[-1]).max())


def _mtf(panel: Axes, found: CalibrationResult, truth: Optics) -> float:
    frequency, off = found.readings["frequency"], 0.0
    for hue, place, row in zip(style.HUES, found.numbers["positions_mm"], found.readings["modulation"], strict=False):
        wanted = truth.modulation(frequency, place, 0.0, found.numbers["pixel_mm"])
        panel.plot(frequency, wanted, color=hue, lw=0.8, ls="--")
        panel.plot(frequency[::6], row[::6], ".", ms=4, color=hue, label=f"{place:+g} mm")
        off = max(off, float(np.abs(row - wanted).max()))
    panel.set(title="Modulation of a slanted edge", xlabel="frequency [1/mm]", ylabel="MTF", xlim=(0, 35))
    panel.legend()
    return off
