"""Calibrations from noisy recordings: the line of focus over lens power, and the roller's axis on the mirrors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.calibration.axis import RollerAxis, find_axis
from vamgpu.calibration.focus import FocusLine, fit_peak, focus_line, tenengrad
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.optics.lens import TunableLens
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROWS, COLUMNS, PERIOD = 24, 80, 20
"""Pixels of a synthetic picture, and of the grating's period in it."""
MIRRORS = 1920
RADIUS = 7.5 / 0.0144
"""Radius of the roller, in columns."""


def calibration(
    device: Device,
    quick: bool = False,
    photons: float = 400.0,
    noise: float = 0.01,
    blur: float = 2.5,
    depth: float = 3.8,
    scans: float = 200,
    seed: float = 0,
) -> Picture:
    """A camera that steps through focus, and a line that scans over a roller; both simulated, with noise."""
    rng = np.random.default_rng(int(seed))
    lens = TunableLens()
    positions = np.arange(-4.0, 4.01, 2.0 if quick else 0.5)
    powers = np.linspace(7.0, 8.0, 31 if quick else 41)
    middle = float(powers.mean())
    stacks = [_pictures(y - lens.slope * (powers - middle), depth, photons, rng) for y in positions]
    line = focus_line(positions, [fit_peak(powers, tenengrad(stack)) for stack in stacks])
    truth = 955.0 + 10.0 * rng.random(20 if quick else int(scans))
    traces = [_scan(axis, noise, blur, rng) for axis in truth]
    found = [find_axis(trace) for trace in traces]
    errors = np.array([axis.column for axis in found]) - truth
    figure, axes = style.sheet("ab;cc;de", 9.4, height_ratios=[1, 0.8, 0.9])
    _sharpness(axes["a"], line, powers, stacks)
    _line(axes["b"], line, lens, middle)
    _trace(axes["c"], traces[0], found[0])
    _edge(axes["d"], traces[0], found[0])
    axes["e"].hist(errors, bins=24, color=style.BLUE)
    axes["e"].set(title="Error of the axis over many scans", xlabel="columns", ylabel="scans")
    facts = (
        Fact("slope of focus over lens power", line.slope, "mm/dpt", 4, lens.slope, "simulated lens in air"),
        Fact("its standard error", line.error, "mm/dpt", 2),
        Fact("largest error of the axis", float(np.abs(errors).max()), "columns", 2, 0.1, "a tenth of a pixel", "≤"),
        Fact("standard deviation of its error", float(errors.std()), "columns", 2),
        Fact("standard error that a fit states", float(np.mean([axis.error for axis in found])), "columns", 2),
        Fact("radius of the roller", found[0].radius, "columns", 6, RADIUS, "simulated roller"),
    )
    caption = (
        "Focus: a camera stands at known positions while the lens steps through its powers; the mirrors show a "
        "grating. The sharpness of an image is its mean squared Sobel gradient. A Lorentzian fitted to it peaks where "
        "the camera is in focus, and the line through all peaks is the lens's slope. The recordings are simulated: "
        f"blur grows with defocus, {photons:.0f} photons per bright pixel, 8 bits.\n\n"
        "Axis: light runs backwards through the projector. One column of mirrors after another sends it to a "
        "photodiode; the roller's shadow has two blurred edges. Step functions fitted to both edges give the axis to a "
        f"fraction of a pixel. The scans are simulated with uneven light, stray light and {100 * noise:g} % noise per "
        "reading."
    )
    return Picture(figure, caption, facts, papers=(ROLL_TO_ROLL,))


def _pictures(distance: np.ndarray, depth: float, photons: float, rng: np.random.Generator) -> np.ndarray:
    """Pictures [distance, row, column] of a grating, out of focus by distances [mm], in 8 bits."""
    sigma = 1.2 * np.sqrt(1.0 + (distance / (0.5 * depth)) ** 2)
    order, x = np.arange(1, 40, 2), (np.arange(COLUMNS) + 0.3) / PERIOD
    waves = np.sin(2.0 * np.pi * order[:, None] * x) * (2.0 / (np.pi * order[:, None]))
    light = 0.5 + 0.9 * np.exp(-0.5 * (2.0 * np.pi * order / PERIOD * sigma[:, None]) ** 2) @ waves
    bright = photons * np.clip(np.repeat(light[:, None], ROWS, axis=1), 0.02, None)
    read = rng.poisson(bright) + 3.0 * rng.standard_normal(bright.shape)
    return np.clip(np.round(200.0 * read / photons), 0, 255).astype(np.uint8)


def _scan(axis: float, noise: float, blur: float, rng: np.random.Generator) -> np.ndarray:
    """Readings of a photodiode behind a roller, one a column."""
    from scipy.special import ndtr

    x = np.arange(MIRRORS, dtype=float)
    beam = np.exp(-0.5 * ((x - 900.0) / 1400.0) ** 2)
    return beam * ndtr((np.abs(x - axis) - RADIUS) / blur) + 0.04 + noise * rng.standard_normal(MIRRORS)


def _sharpness(axis: Axes, line: FocusLine, powers: np.ndarray, stacks: list[np.ndarray]) -> None:
    fine = np.linspace(powers[0], powers[-1], 400)
    for n, at in enumerate(np.linspace(0, len(stacks) - 1, 3).round().astype(int)):
        hue = style.HUES[n]
        axis.plot(powers, tenengrad(stacks[at]), ".", color=hue, ms=4)
        axis.plot(fine, line.peaks[at](fine), color=hue, label=f"camera at {line.positions[at]:+g} mm")
    axis.set(title="Sharpness and the Lorentzian through it", xlabel="lens power [dpt]", ylabel="Tenengrad")
    axis.legend()


def _line(axis: Axes, line: FocusLine, lens: TunableLens, middle: float) -> None:
    power = np.array([peak.power for peak in line.peaks])
    ends = np.array([power.min(), power.max()])
    axis.plot(ends, lens.slope * (ends - middle), color=style.FAINT, lw=5, label=f"lens, {lens.slope:.1f} mm/dpt")
    axis.plot(ends, line.slope * ends + line.intercept, color=style.BLUE, label=f"fit, {line.slope:.2f} mm/dpt")
    axis.plot(power, line.positions, "o", color=style.ORANGE, ms=4, label="peaks")
    axis.set(title="Focus over lens power", xlabel="lens power [dpt]", ylabel="camera [mm]")
    axis.legend()


def _trace(axis: Axes, trace: np.ndarray, found: RollerAxis) -> None:
    axis.plot(trace, color=style.BLUE, lw=0.8)
    for edge in found.edges:
        axis.axvline(edge.column, color=style.ORANGE, ls=(0, (4, 3)))
    axis.axvline(found.column, color=style.RED)
    axis.text(found.column, 0.62, f"  axis at {found.column:.2f}", color=style.RED)
    axis.set(title="Photodiode while one column of mirrors after another is lit", xlabel="column", ylabel="reading",
             xlim=(0, trace.size - 1))  # fmt: skip


def _edge(axis: Axes, trace: np.ndarray, found: RollerAxis) -> None:
    edge = found.edges[0]
    part = np.arange(int(edge.column) - 20, int(edge.column) + 21)
    axis.plot(part, trace[part], ".", color=style.BLUE)
    axis.axvline(edge.column, color=style.ORANGE, ls=(0, (4, 3)))
    axis.set(title=f"Left edge: {edge.column:.2f} ± {edge.error:.2f}", xlabel="column", ylabel="reading")
