"""Cure-through layer by layer: the sawtooth, the correction, and the error that remains."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.curethrough import HOUR, PAPER
from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.curethrough.correction import Correction, Corrector
from vamgpu.curethrough.dose import Judge, blocks, column_dose
from vamgpu.curethrough.layers import LayerPrinter
from vamgpu.curethrough.printer import levels_of
from vamgpu.reports import style
from vamgpu.units import mJ_cm3, mW_cm2, um

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def layerwise(
    device: Device, quick: bool = False, absorption_height: float = 0.11, slice_height: float = 0.05,
    critical_mJ_cm3: float = 576.0, speed_mm_h: float = 1000.0, full_mW_cm2: float = 100.0, dark_mW_cm2: float = 1.7,
) -> Picture:  # fmt: skip
    """Four blocks above each other, as sliced and as corrected."""
    printer = LayerPrinter(absorption_height, critical_mJ_cm3 * mJ_cm3, slice_height, slice_height * HOUR / speed_mm_h,
                           levels_of(full_mW_cm2 * mW_cm2, dark_mW_cm2 * mW_cm2))  # fmt: skip
    part = np.zeros((90, 8, 60), np.uint8)
    for start, stop in ((4, 12), (18, 22), (30, 50), (58, 80)):
        part[start:stop, :, 6:-6] = 255
    part[36:42, :, 20:40] = 0
    corrector = Corrector(Correction(printer), part.shape, device)
    shown = np.empty_like(part)
    for block in corrector.run(part):
        shown[block.start : block.start + block.table.shape[0]] = block.levels
    over, under = {}, {}
    for name, levels in (("before", part), ("after", shown)):
        judge = Judge(printer, part.shape[1:], device)  # type: ignore[arg-type]
        for start, stop in blocks(len(part)):
            judge.step(levels[start:stop], part[start:stop])
        over[name], under[name] = float(judge.over().max()), float(judge.under().max())
    figure, axes = style.sheet("abe;cdf", 7.2, width_ratios=[0.5, 1.2, 1.2])
    for letters, levels, title in (("ab", part, "as sliced"), ("cd", shown, "corrected")):
        style.shown(axes[letters[0]], levels[::-1, 4].T, f"Slices {title}", cmap="gray", vmin=0, vmax=255,
                    aspect="auto")  # fmt: skip
        _dose(axes[letters[1]], printer, part[:, 4, 30], levels[:, 4, 30], f"Dose {title}")
        _shares(axes["e" if letters == "ab" else "f"], printer, levels[:, 4, 30])
    zeta = np.array([70.0, 69.0 + 1e-9])
    top, far = column_dose(printer, shown[:, 4, 30], zeta)
    facts = (
        Fact("ω, greatest over least dose of a layer", float(top / far), "", 4, 2.848, "paper"),
        Fact("least cure-through", printer.least_cure_through / um, "µm", 3, 5.0, "paper, about"),
        Fact("cured void of the worst column before", over["before"] / um, "µm", 4),
        Fact("cured void of the worst column after", over["after"] / um, "µm", 3),
        Fact("uncured part of the worst column before", under["before"] / um, "µm", 3),
        Fact("uncured part of the worst column after", under["after"] / um, "µm", 3),
        Fact("features whose back side full light does not cure, columns", float((corrector.missed > 0).sum()), "", 3),
    )
    caption = (
        "The platform stops for every slice; the dose therefore jumps from layer to layer. The correction gives the "
        "far edge of every layer the critical dose, and the void nothing. Because level 0 is not dark, a little of the "
        "void in front of every feature still cures. Right: the contributions of single slices."
    )
    return Picture(figure, caption, facts, None, (PAPER,))


def _dose(axis: Axes, printer: LayerPrinter, part: np.ndarray, levels: np.ndarray, title: str) -> None:
    zeta = np.linspace(-0.99, len(levels) - 1, 40 * len(levels))
    dose = column_dose(printer, levels, zeta)
    solid = part[np.clip(np.ceil(zeta), 0, len(part) - 1).astype(int)] > 0
    z = zeta * printer.slice_height
    axis.fill_between(z, 0, 1, where=solid, transform=axis.get_xaxis_transform(), color=style.GLASS, lw=0)  # type: ignore
    axis.plot(z, np.where(dose >= 1.0, dose, np.nan), color=style.RED, lw=1.0)
    axis.plot(z, np.where(dose < 1.0, dose, np.nan), color=style.BLUE, lw=1.0)
    axis.set(title=f"{title}; red is cured", xlabel="from the platform [mm]", ylabel="Ω", ylim=(0, None))


def _shares(axis: Axes, printer: LayerPrinter, levels: np.ndarray) -> None:
    zeta = np.linspace(20.0, 54.0, 1400)
    for n in range(21, 54):
        alone = np.zeros_like(levels)
        alone[n] = levels[n]
        share = printer.phi[alone[n]] * np.where(zeta <= n, 10.0 ** (-(n - zeta) * printer.eta), 0.0)
        axis.plot(zeta * printer.slice_height, share, lw=0.7, color=style.HUES[n % len(style.HUES)])
    axis.set(title="Shares of slices 21 to 53", xlabel="from the platform [mm]", ylabel="Ω")
