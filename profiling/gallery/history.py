"""A resin that is used five times: print times, a model for them, and its predictions."""

from __future__ import annotations

from typing import Any

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.aging import BENCHY_DEVIATIONS, BENCHY_SECONDS, AgingFit, fit_aging
from vamgpu.chemistry.history import recovery
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE
from vamgpu.reports import style


def history(
    device: Device,
    quick: bool = False,
    lost: float = 0.125,
    depth: float = 30.0,
    diffusivity: float = 4e-6,
    hours: float = 16.0,
) -> Picture:
    """lost: share of the resin a print takes (10 to 15 % in the paper). depth, diffusivity, hours: a vial at night."""
    found, measured = fit_aging(lost=lost), np.array(BENCHY_SECONDS)
    night = recovery(diffusivity, 3600.0 * hours, depth)
    last = float(np.sqrt(np.mean(np.diff(measured) ** 2)))
    facts = (
        Fact("error of a generation left out", found.error, "s", 3),
        Fact("the same, taking the mean of the others", found.naive_error, "s", 3),
        Fact("the same, taking the generation before", last, "s", 3),
        Fact("residual of the fit to all five, which is no test", found.residual, "s", 3),
        Fact("oxygen that a print takes from the remaining resin", 100 * found.aging.spent, "%", 3),
        Fact("missing oxygen that a full vial regains by the next day", 100 * recovery(1.0, found.aging.refill, 1.0),
             "%", 3),
        Fact(f"the same by diffusion alone, {hours:g} h and {depth:g} mm deep", 100 * night, "%", 2),
        Fact("longest over shortest print", measured.max() / measured.min(), "", 3),
    )  # fmt: skip
    titles = ("generation", "measured [s]", "fitted [s]", "predicted from the others [s]", "error [s]")
    rows = tuple(
        (str(k + 1), (t, t + r, t + e, e))
        for k, (t, r, e) in enumerate(zip(measured, found.residuals, found.left_out, strict=True))
    )
    caption = (
        "Print times of five generations of resin. Each print uses up oxygen in the resin around the part and removes "
        "some resin; stirring and a night in air restore oxygen. Less resin under the same surface gets more of it. "
        "Three numbers fit five generations well, which proves little; each is therefore also predicted from the "
        "other four. The last time, longer than the one before, is not predicted. The fit returns far more "
        "oxygen to the vial than diffusion alone would in the assumed resin. The times do not show how it returned, by "
        "stirring or otherwise, nor that oxygen is the only cause of aging."
    )
    return Picture(_drawn(found, measured), caption, facts, Table(titles, (".1f", ".1f", ".1f", "+.1f"), rows),
                   (AUTOMATIC_EXPOSURE,))  # fmt: skip


def _drawn(found: AgingFit, measured: np.ndarray) -> Any:
    figure, axes = style.sheet("aab", 4.0)
    ages = np.arange(1, len(measured) + 1)
    bars: dict[str, Any] = {"fmt": "o", "color": style.INK, "capsize": 3}
    axes["a"].errorbar(ages, measured, BENCHY_DEVIATIONS, **bars, label="measured, 5 prints")
    later = found.aging.seconds(len(measured) + 2)
    axes["a"].plot(np.arange(1, len(later) + 1), later, color=style.BLUE, label="fitted to all, and on")
    axes["a"].plot(ages, measured + np.array(found.left_out), "D", color=style.ORANGE, mfc="none",
                   label="predicted from the others")  # fmt: skip
    axes["a"].set(title="Time of a print", xlabel="generation of resin", ylabel="s", ylim=(30, None))
    axes["a"].legend()
    names = ("fit to all", "left out", "mean of\nthe others")
    errors = (found.residual, found.error, found.naive_error)
    axes["b"].bar(names, errors, color=(style.FAINT, style.ORANGE, style.QUIET), width=0.6)
    for place, value in enumerate(errors):
        axes["b"].text(place, value, f"{value:.1f} s", ha="center", va="bottom")
    axes["b"].set(title="Root mean square error", ylabel="s")
    return figure
