"""A part of bridges, uncorrected and corrected: height errors of features of many sizes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.curethrough.correction import Correction
from vamgpu.curethrough.job import Outcome, correct_stack
from vamgpu.curethrough.pictures import verdict
from vamgpu.curethrough.printer import Printer, levels_of
from vamgpu.curethrough.profile import Flat
from vamgpu.curethrough.report import PAPER
from vamgpu.curethrough.score import Features, features
from vamgpu.reports import style
from vamgpu.units import hour, mJ_cm3, mm, mW_cm2, um

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BASE, SPAN, BEHIND = 1.0, 3.0, 1.0
"""Heights [mm] of the plate at the platform, of the void below the bridges, and of that behind them."""
TICKS = (0.2, 0.5, 1.0, 2.0, 4.0)
LONG, WIDE, POST = 24, 8, 3
"""Pixels of a bridge, and of the posts on both sides of it."""


def curethrough_part(
    device: Device, quick: bool = False, absorption_height: float = 2.0, gel_dose: float = 115.2 * mJ_cm3,
    gels: float = 5.0, speed: float = 750.0 * mm / hour, light: float = 75.0 * mW_cm2, dark: float = 0.75 * mW_cm2,
    slice_height: float = 50.0 * um,
) -> Picture:  # fmt: skip
    """Bridges 0.2 to 4 mm high on posts, corrected for a critical dose of ``gels`` gel doses with several Ω_max."""
    machine = Printer(absorption_height, gels * gel_dose, slice_height, speed, levels_of(light, dark))
    heights = np.round(np.geomspace(0.2, 4.0, 5 if quick else 10) / slice_height).astype(int)
    stack = bridges(heights, slice_height)
    most = (1.5, float("inf")) if quick else (1.25, 1.5, 2.0, float("inf"))
    found = {value: correct_stack(Correction(machine, Flat(value)), stack, device=device) for value in most}
    figure, axes = style.sheet("ab;cd", 7.6)
    best = found[most[-1]]
    for name, shown, title in (("a", best.before, "Uncorrected"), ("b", best.after, "Corrected, as much dose as fits")):
        assert shown is not None
        picture = verdict(machine, shown.levels[:, best.sample.across], best.solid[:, best.sample.across])
        _section(axes[name], picture, title, slice_height)
    rows = []
    for (value, outcome), hue in zip(found.items(), style.HUES, strict=False):
        label = "as much as fits" if value == float("inf") else f"at most {value:g} critical doses"
        sizes, at_critical = ratios(outcome, heights, 1.0)
        _, at_gel = ratios(outcome, heights, 1.0 / gels)
        axes["c"].plot(sizes, at_critical, marker="o", ms=3.5, color=hue, label=label)
        axes["d"].plot(sizes, at_gel, marker="o", ms=3.5, color=hue, label=label)
        rows.append((label, (float(np.mean(at_critical)), float(np.max(at_critical)), float(np.mean(at_gel)))))
    for name, title in (("c", "Cured from the critical dose on"), ("d", "Cured from the gel dose on")):
        axes[name].set(title=title, xscale="log", xlabel="height of the bridge [mm]",
                       ylabel="height error, corrected / uncorrected")  # fmt: skip
        axes[name].set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
        axes[name].minorticks_off()
    axes["c"].set_yscale("log")
    axes["d"].set_ylim(0, 1)
    axes["d"].legend(loc="lower left", title="dose inside", alignment="left")
    caption = (
        "Bridges of growing height over 3 mm of void. The light comes from above, and higher parts cure later. Without "
        "correction, the light of every bridge cures the void before it (orange), and its back side lacks dose (red). "
        "Corrected slices begin the light in the void behind a bridge and end it early, so that both its sides just "
        "reach the critical dose. Judged by the critical dose, little remains but the rounding to 256 levels. Judged "
        "by the gel dose, which is a fraction of the critical dose, all doses between the two count as errors, "
        "regardless of the dose inside. All scores are computed from the 8-bit slices."
    )
    header = ("dose inside", "mean ratio, critical dose", "largest", "mean ratio, gel dose")
    table = Table(header, (".2g", ".2g", ".3f"), tuple(rows))
    return Picture(figure, caption, _facts(machine, best), table, papers=(PAPER,))


def bridges(heights: np.ndarray, slice_height: float) -> np.ndarray:
    """Slices [slice, y, x] of a plate, posts, and a bridge of every height [slices], side by side along x."""
    base, span, behind = (round(part / slice_height) for part in (BASE, SPAN, BEHIND))
    width = LONG + 2 * POST
    stack = np.zeros((base + span + int(heights.max()) + behind, WIDE + 4, width * len(heights) + 4), np.uint8)
    for k, height in enumerate(heights):
        left = 2 + k * width
        stack[:base, 2:-2, left : left + width] = 255
        top = base + span + int(height)
        for post in (left, left + width - POST):
            stack[:top, 2:-2, post : post + POST] = 255
        stack[base + span : top, 2:-2, left : left + width] = 255
    return stack


def ratios(outcome: Outcome, heights: np.ndarray, critical: float) -> tuple[np.ndarray, np.ndarray]:
    """Heights [mm] of the bridges, and their corrected over uncorrected errors, if ``critical`` doses cure."""
    assert outcome.after is not None
    step, solid = outcome.machine.slice_height, outcome.solid
    errors = [_errors(features(outcome.machine, levels, solid, critical), heights, step)
              for levels in (outcome.before.levels, outcome.after.levels)]  # fmt: skip
    return heights * step, errors[1] / errors[0]


def _errors(found: Features, heights: np.ndarray, step: float) -> np.ndarray:
    """Mean height error [mm] of the bridges of every height; posts do not count."""
    front = round(BASE / step) + round(SPAN / step)
    bridge = found.front == front
    return np.array([found.error[bridge & (found.back - found.front == height)].mean() for height in heights])


def _section(axis: Axes, picture: np.ndarray, title: str, step: float) -> None:
    axis.imshow(picture, aspect="auto", extent=(0, picture.shape[1], 0, len(picture) * step), interpolation="nearest")
    axis.set(title=title, xlabel="pixel along x", ylabel="height above the platform [mm]")
    axis.grid(False)


def _facts(machine: Printer, outcome: Outcome) -> tuple[Fact, ...]:
    assert outcome.after is not None and outcome.ratio is not None
    before, after = (one.heights for one in (outcome.before, outcome.after))
    return (
        Fact("Φ of full light", machine.phi_max),
        Fact("height over which full light reaches the critical dose", machine.build_up_height() / um, "µm"),
        Fact("slices added after the last", machine.tail),
        Fact("height errors of the part, corrected divided by uncorrected", outcome.ratio, "", 2, 0.01, bound="≤"),
        Fact("largest cure-through of a pixel, uncorrected", float(before.over.max()), "mm", 3),
        Fact("largest cure-through of a pixel, corrected", 1e3 * float(after.over.max()), "µm", 3, 1e3 * 0.1 *
             machine.slice_height, "a tenth of a slice", "≤"),
        Fact("voids too short for this speed", float(outcome.closed.sum()) if outcome.closed is not None else 0.0, "",
             4, 0.0, bound="≤"),
    )  # fmt: skip
