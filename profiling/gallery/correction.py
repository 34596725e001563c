"""Slices corrected for cure-through: one column, a map of the possible speed, and its limits."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from profiling.curethrough_formulas import highest_dose
from profiling.gallery.curethrough import HOUR, PAPER
from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.curethrough.correction import Correction, Corrector
from vamgpu.curethrough.dose import Judge, column_dose
from vamgpu.curethrough.feasibility import feasibility
from vamgpu.curethrough.printer import Printer, levels_of
from vamgpu.reports import style
from vamgpu.units import mJ_cm3, mW_cm2, um

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def correction(
    device: Device, quick: bool = False, absorption_height: float = 2.0, gel_mJ_cm3: float = 115.2,
    speed_mm_h: float = 750.0, full_mW_cm2: float = 75.0, dark_mW_cm2: float = 1.0, slice_height: float = 0.05,
    tail: float = 3,
) -> Picture:  # fmt: skip
    """A part with voids, before and after; the critical dose is five times the gel dose."""
    light = levels_of(full_mW_cm2 * mW_cm2, dark_mW_cm2 * mW_cm2)
    printer = Printer(absorption_height, 5 * gel_mJ_cm3 * mJ_cm3, slice_height, speed_mm_h / HOUR, light)
    part = _part(120 if quick else 240)
    corrector = Corrector(Correction(printer, tail=int(tail)), part.shape, device)
    shown = np.empty((corrector.slices, *part.shape[1:]), np.uint8)
    after = Judge(printer, part.shape[1:], device)  # type: ignore[arg-type]
    for block in corrector.run(part):
        shown[block.start : block.start + block.table.shape[0]] = block.levels
        after.add(block.table, block.words, block.start // 32)
    wanted = np.concatenate([part, np.zeros((corrector.slices - len(part), *part.shape[1:]), np.uint8)])
    before = Judge(printer, part.shape[1:], device)  # type: ignore[arg-type]
    for start in range((len(wanted) - 1) // 32 * 32, -1, -32):
        before.step(wanted[start : start + 32], wanted[start : start + 32])
    figure, axes = style.sheet("aaab;cdef", 7.4, height_ratios=[1.2, 1.0])
    y, x = part.shape[1] // 2, part.shape[2] // 3
    _column(axes["a"], printer, wanted[:, y, x], shown[:, y, x])
    limits = feasibility(corrector, part)
    drawn = style.shown(axes["b"], np.minimum(limits.speed, 4 * printer.speed).T * HOUR, "Fastest speed [mm/h]",
                        cmap="viridis")  # fmt: skip
    style.bar(drawn, axes["b"], "")
    for letter, title, stack in (("c", "Slices as sliced", wanted), ("d", "Slices corrected", shown)):
        style.shown(axes[letter], stack[::-1, y].T, title, cmap="gray", vmin=0, vmax=255, aspect="auto")
    _reach(axes["e"], printer)
    _most(axes["f"], printer, gel_mJ_cm3)
    good = limits.feasible
    facts = (
        Fact("pixels where every feature gets its dose and every void opens", 100 * float(good.mean()), "%", 3),
        Fact("cured void before, mean", float(before.over().mean()) / um, "µm", 4),
        Fact("cured void after, mean", float(after.over().mean()) / um, "µm", 3),
        Fact("uncured part before, mean", float(before.under().mean()) / um, "µm", 4),
        Fact("uncured part after, mean", float(after.under().mean()) / um, "µm", 3),
        Fact("height over which full light reaches the critical dose", printer.build_up_height() / um, "µm", 4),
        Fact("slices added after the last", corrector.slices - len(part), "", 3),
    )
    caption = (
        "Full light in the void behind a feature gives its back side the critical dose. Inside, the dose rises as "
        "far as allowed and falls to the critical dose at the front; everything else is dark. Only the first feature "
        "lies on the platform and keeps its light. The map shows the highest speed at which every feature of a pixel "
        "gets its dose with the slices shown. Below: slices from the side, the height over which full light reaches "
        "the critical dose, and the highest dose by feature height for critical doses of 3, 5 and 8 gel doses."
    )
    return Picture(figure, caption, facts, None, (PAPER,))


def _part(slices: int) -> np.ndarray:
    """Steps, a channel that slants through them, and a spherical void; uint8 [slice, y, x]."""
    n = slices // 2
    z, y, x = np.ogrid[:slices, :n, : 2 * n]
    solid = z < slices * (0.55 + 0.45 * (x // (n // 3)) / 6.0)
    solid = solid & ((z - 0.45 * slices - 0.12 * x) ** 2 + (y - 0.5 * n) ** 2 > (0.09 * slices) ** 2)
    solid &= (z - 0.3 * slices) ** 2 + (y - 0.5 * n) ** 2 + (x - 1.5 * n) ** 2 > (0.12 * slices) ** 2
    return np.where(solid, 255, 0).astype(np.uint8)


def _column(axis: Axes, printer: Printer, wanted: np.ndarray, shown: np.ndarray) -> None:
    zeta = np.linspace(0, len(shown), 6 * len(shown))
    z = zeta * printer.slice_height
    solid = wanted[np.minimum(zeta.astype(int), len(wanted) - 1)] > 0
    axis.fill_between(z, 0, 1, where=solid, transform=axis.get_xaxis_transform(), color=style.GLASS, lw=0)  # type: ignore
    axis.plot(z, column_dose(printer, wanted, zeta), color=style.ORANGE, label="as sliced")
    axis.plot(z, column_dose(printer, shown, zeta), color=style.BLUE, label="corrected")
    axis.axhline(1.0, color=style.INK, lw=1.0, ls=(0, (4, 3)))
    axis.set(title="Dose along one column; the part is shaded", xlabel="from the platform [mm]", ylabel="Ω")
    axis.legend(loc="upper right")


def _reach(axis: Axes, printer: Printer) -> None:
    dose = np.linspace(0.2, 0.98 * printer.phi_max, 200)
    height = printer.absorption_height * np.log10(printer.phi_max / (printer.phi_max - dose))
    axis.plot(dose, height, color=style.BLUE)
    axis.set(title="Height to reach a dose", xlabel="Ω", ylabel="[mm]")


def _most(axis: Axes, printer: Printer, gel: float) -> None:
    tall = np.linspace(0.01, 10.0, 200)
    for times, color in zip((3, 5, 8), style.HUES, strict=False):
        one = replace(printer, critical_dose=times * gel * mJ_cm3)
        if one.phi_max > 1.0:
            most = highest_dose(tall / one.slice_height, one.phi_min, one.phi_max, one.eta)
            axis.plot(tall, times * most, color=color, label=f"{times} D_gel")
    axis.set(title="Highest dose / gel dose", xlabel="feature height [mm]", ylim=(0, None))
    axis.legend()
