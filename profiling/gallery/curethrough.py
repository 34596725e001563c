"""Doses of a continuous print: constraint curves of a feature, and the effect of the printer's settings on them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from profiling.curethrough_formulas import closed_sum, doses, highest_dose, highest_place
from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.curethrough.printer import Printer, build_up, die_down, levels_of
from vamgpu.reports import style
from vamgpu.units import mJ_cm3, mW_cm2, um

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER = (
    "Z. D. Pritchard, M. P. de Beer, R. J. Whelan, T. F. Scott, M. A. Burns, Modeling and correcting cure-through in "
    "continuous stereolithographic 3D printing, Adv. Mater. Technol. (2019) 1900700"
)
HOUR = 3600.0


def curethrough(
    device: Device, quick: bool = False, absorption_height: float = 2.0, slice_height: float = 0.05,
    speed_mm_h: float = 1000.0, critical_mJ_cm3: float = 576.0, full_mW_cm2: float = 100.0, dark_mW_cm2: float = 1.0,
    height: float = 1.0,
) -> Picture:  # fmt: skip
    """The region in which corrected doses must lie."""
    light = levels_of(full_mW_cm2 * mW_cm2, dark_mW_cm2 * mW_cm2)
    base = Printer(absorption_height, critical_mJ_cm3 * mJ_cm3, slice_height, speed_mm_h / HOUR, light)
    figure, axes = style.sheet("aab;cde;fgh", 8.4)
    _region(axes["a"], base, height)
    _by_height(axes["b"], replace(base, light=levels_of(120 * mW_cm2, 2 * mW_cm2)))
    changes = {
        "c": ("Base case", [base], [height]),
        "d": ("Feature height", [base] * 3, [height, 0.5 * height, 1.5 * height]),
        "e": ("Absorption height", [replace(base, absorption_height=f * absorption_height) for f in (1, 0.5, 1.5)],
              [height] * 3),
        "f": ("Speed, or critical dose", [replace(base, speed=f * base.speed) for f in (1, 0.5, 1.5)], [height] * 3),
        "g": ("Full light", [replace(base, light=levels_of(f * light[-1], light[0])) for f in (1, 0.5, 1.5)],
              [height] * 3),
    }  # fmt: skip
    for letter, (title, printers, tall) in changes.items():
        _curves(axes[letter], title, printers, tall)
    apart = _streamed(axes["h"], base, device, 300 if quick else 3000)
    facts = (
        Fact("dose of level 0", base.phi_min * base.critical_dose / mJ_cm3, "mJ/cm³", 4, 36.0, "paper"),
        Fact("Φ of full light", base.phi_max, "", 4),
        Fact("height over which full light reaches the critical dose", base.build_up_height() / um, "µm", 4),
        Fact("Ω* of the feature", float(highest_dose(height / slice_height, base.phi_min, base.phi_max, base.eta))),
        Fact("largest difference of a streamed dose from the closed sum, over the largest dose", apart, "", 2, 1e-5,
             "float32", "≤"),
    )  # fmt: skip
    caption = (
        "A slice also lights the slices that were printed before it; over each absorption height, the light falls to "
        "a tenth. The dose in a feature must therefore stay within three limits: at least the critical dose (i), at "
        "most what full light builds up from its back side (ii), and low enough to decay to the critical dose at its "
        "front (iii). Blue curves lower a setting by half, orange curves raise it by half. The critical dose is 576 "
        "mJ/cm³ unless stated otherwise."
    )
    return Picture(figure, caption, facts, None, (PAPER,))


def _region(axis: Axes, printer: Printer, height: float) -> None:
    upper, lower = 0.0, height / printer.slice_height
    zeta = np.linspace(upper, lower, 400)
    ii = build_up(zeta, lower, printer.phi_max, printer.eta)
    iii = die_down(zeta, upper, printer.phi_min, printer.eta)
    z = zeta * printer.slice_height
    axis.fill_between(z, 1.0, np.minimum(ii, iii), color=style.GLASS)
    axis.axhline(1.0, color=style.INK, lw=1.2, label="(i) critical dose")
    axis.plot(z, ii, color=style.ORANGE, label="(ii) full light from the back side")
    axis.plot(z, iii, color=style.BLUE, label="(iii) dies down to the front")
    place = highest_place(upper, lower, printer.phi_min, printer.phi_max, printer.eta)
    dose = float(highest_dose(lower, printer.phi_min, printer.phi_max, printer.eta))
    axis.plot([place * printer.slice_height], [dose], "o", color=style.RED)
    axis.annotate("ζ*, Ω*", (place * printer.slice_height, dose), (8, 4), textcoords="offset points")
    axis.set(title="Where a feature's dose may lie", xlabel="from the front to the back side [mm]", ylabel="Ω",
             ylim=(0.8, 1.25 * dose))  # fmt: skip
    axis.legend(loc="upper left")


def _by_height(axis: Axes, printer: Printer) -> None:
    thick = np.linspace(0.0, 6.0, 300)
    axis.plot(thick, highest_dose(thick / printer.eta, printer.phi_min, printer.phi_max, printer.eta), color=style.BLUE)
    axis.axhline(printer.phi_max, color=style.QUIET, ls=(0, (4, 3)), lw=1.1)
    axis.set(title="Highest dose within a feature", xlabel="height / absorption height", ylabel="Ω*", ylim=(0, None))


def _curves(axis: Axes, title: str, printers: list[Printer], heights: list[float]) -> None:
    for printer, height, color in zip(printers, heights, (style.INK, style.BLUE, style.ORANGE), strict=False):
        upper, lower = 0.0, height / printer.slice_height
        zeta = np.linspace(upper, lower, 300)
        ii = build_up(zeta, lower, printer.phi_max, printer.eta)
        iii = die_down(zeta, upper, printer.phi_min, printer.eta)
        axis.plot(zeta * printer.slice_height, np.minimum(ii, iii), color=color)
    axis.axhline(1.0, color=style.QUIET, lw=1.0)
    axis.set(title=title, xlabel="[mm]", ylabel="Ω", ylim=(0.9, 3.2))


def _streamed(axis: Axes, printer: Printer, device: Device, slices: int) -> float:
    """Draw a random column's dose, and return the device's deviation from the closed sum."""
    rng = np.random.default_rng(0)
    stack = np.repeat(rng.integers(0, 256, (-(-slices // 50), 4, 16)), 50, axis=0)[:slices].astype(np.uint8)
    found = np.empty(stack.shape)
    for start, block in doses(printer, stack, device):
        found[start : start + len(block)] = block
    checked = range(0, slices, max(1, slices // 40))
    wanted = np.array([closed_sum(printer, stack, n) for n in checked])
    axis.plot(found[:300, 0, 0], color=style.BLUE, lw=1.2)
    axis.set(title="A column of random levels", xlabel="slice", ylabel="Ω")
    return float(np.abs(found[list(checked)] - wanted).max() / wanted.max())
