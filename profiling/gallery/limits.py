"""Performance and limits of a web machine: speeds, time of an angle, flow, and the frequencies that light reaches."""

from __future__ import annotations

from math import inf, pi, radians
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.optics.film import Film
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.reports import style
from vamgpu.units import Pa_s, kg_m3, minute, ms
from vamgpu.webs.display import Display
from vamgpu.webs.limits import WebLimits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_DENSITY = 1.1 * kg_m3
"""The density with which the paper computes its viscosity; a resin has a thousand times this density."""


def limits(
    device: Device,
    quick: bool = False,
    radius: float = 7.5,
    thickness: float = 3.0,
    step_deg: float = 0.5,
    bins: float = 3,
    settle_ms: float = 5.0,
    rate: float = 266.0,
    speed_mm_min: float = 48.0,
) -> Picture:
    """The machine of the roll-to-roll paper."""
    film = Film(thickness, 1.49, 1.33, 0.22)
    roller = Roller(radius, film, radians(step_deg), legs=0.5 * pi * (radius + 0.5 * thickness))
    lens = TunableLens(index=1.33, bins=int(bins), settle=settle_ms * ms)
    found = WebLimits(roller, lens, Display(rate), speed_mm_min / minute)
    limiting = found.limiting
    paper = WebLimits(roller, lens, found.display, found.speed, density=PAPER_DENSITY)
    facts = (
        Fact("sampling along the web at 1 mm/s", found.sampling_limit(1.0), "/mm", expected=66, source="paper, S12"),
        Fact("frames", found.frame_rate, "/s", 3, expected=30.6, source="48 mm/min, mid-line"),
        Fact("slot of a frame", 1e3 * found.slot, "ms", 3, expected=32.7, source="48 mm/min, mid-line"),
        Fact("data of 8-bit 1080p", found.data_rate / 1e6, "MB/s", 3, expected=63, source="48 mm/min, mid-line"),
        Fact("straight length of a window, to 5 % of light", found.window, "mm", expected=13.6, source="paper, S11"),
        Fact("angular coverage", found.coverage, "rad", expected=2.2, source="paper"),
        Fact("viscosity needed at 1.1 kg/m³", paper.viscosity_needed / Pa_s, "Pa·s",
             expected=43.7, source="paper, S13"),
        Fact("viscosity needed at 1100 kg/m³", found.viscosity_needed / Pa_s, "Pa·s", 3),
        Fact("defocus of the worst column", found.defocus, "mm", 3, 0.5 * found.depth_of_focus, "half a depth of focus",
             "≤"),
        Fact("greatest speed", limiting.speed * minute, "mm/min", 4),
    )  # fmt: skip
    reach = tuple((s.name, (s.speed * minute, s.speed / found.speed)) for s in found.speeds if s.speed < inf)
    table = Table(("limit", "speed [mm/min]", "divided by the design speed"), (".4g", ".3g"), reach)
    caption = (
        "Four limits on the speed of a web that turns by a fixed angle per frame: the mirrors' rate, the settling of "
        "the lens, the link to the lens, and their sum, because the machine does one after another. At the design "
        "speed, light can be on while the lens neither gets a command nor moves. The slower the web, the longer the "
        "uncured resin hangs in the light, and the more viscous it must be. A film in a bath of lower index gets light "
        "from a limited range of angles, so a wedge of spatial frequencies about its normal is missing."
    )
    return Picture(figure_of(found), caption, facts, table, (ROLL_TO_ROLL,))


def figure_of(found: WebLimits) -> Figure:
    """Greatest speeds, the time of one angle, viscosity against speed, and the reach in spatial frequency."""
    figure, axes = style.sheet("aab;ccd", 6.6, width_ratios=[1, 1, 1.1])
    _speeds(axes["a"], found)
    _frequencies(axes["b"], found)
    _pose(axes["c"], found)
    _flow(axes["d"], found)
    return figure


def _speeds(axis: Axes, found: WebLimits) -> None:
    known = [limit for limit in found.speeds if limit.speed < inf][::-1]
    values = [limit.speed * minute for limit in known]
    hue = [style.RED if limit == found.limiting else style.BLUE for limit in known]
    axis.barh([limit.name for limit in known], values, color=hue, height=0.6)
    axis.axvline(found.speed * minute, color=style.INK, ls=(0, (4, 3)), lw=1.2)
    axis.text(found.speed * minute, len(known) - 0.42, " expected", fontsize=8.5, va="bottom")
    for row, value in enumerate(values):
        axis.text(value, row, f" {value:.0f}", va="center")
    fastest = found.limiting
    axis.set(title=f"Greatest speed: {fastest.speed * minute:.0f} mm/min, limited by {fastest.name}",
             xlabel="web [mm/min]", xlim=(0, 1.12 * max(values)), ylim=(-0.6, len(known) - 0.1))  # fmt: skip
    axis.grid(False, axis="y")


def _frequencies(axis: Axes, found: WebLimits) -> None:
    covered = found.k_space(301).astype(float)
    inside = np.hypot(*np.meshgrid(np.arange(301) - 150, np.arange(301) - 150)) <= 150.5
    picture = np.where(inside, 1.0 + covered, 0.0)
    from matplotlib.colors import ListedColormap

    colors = ListedColormap(["#ffffff", style.FAINT, style.BLUE])
    title = f"Frequencies reached: {100 * found.covered_share:.0f} %"
    style.shown(axis, picture, title, cmap=colors, vmin=0, vmax=2)
    axis.text(150, 290, "missing wedge", ha="center", va="top", fontsize=8.5)
    axis.text(296, 150, "along the web ", ha="right", va="center", color="white", fontsize=8.5)
    axis.text(150, 4, "into the film", ha="center", va="bottom", fontsize=8.5)


def _pose(axis: Axes, found: WebLimits) -> None:
    bins, order, start = found.lens.bins, [], 0.0
    parts = ((found.display.wire, style.ORANGE, "command"), (found.lens.settle, style.FAINT, "lens settles"))
    free = found.advance / found.speed - found.moves * (found.display.wire + found.lens.settle)
    for plane in range(bins):
        moved = found.moves == bins or plane > 0
        for length, color, name in (*(parts if moved else ()), (max(free, 0.0) / bins, style.BLUE, "light")):
            axis.barh(0, 1e3 * length, left=1e3 * start, color=color, height=0.8,
                      label=name if name not in order else None)  # fmt: skip
            order.append(name)
            start += length
    axis.plot([1e3 * found.pose_time] * 2, [-0.5, 0.75], color=style.RED, lw=1.4)
    axis.text(1e3 * found.pose_time, 0.62, "  least time of an angle", color=style.RED, fontsize=8.5, va="center")
    axis.set(title=f"An angle at {found.speed * minute:.4g} mm/min: light for {100 * max(found.duty, 0):.0f} % of it",
             xlabel="time [ms]", yticks=[], ylim=(-0.9, 0.85), xlim=(0, None))  # fmt: skip
    axis.legend(ncols=3, loc="lower left")
    axis.grid(False, axis="y")


def _flow(axis: Axes, found: WebLimits) -> None:
    speeds = np.geomspace(0.1, 10.0, 60) * found.speed
    needed = found.viscosity_needed * found.speed / speeds / Pa_s
    axis.loglog(speeds * minute, needed, color=style.BLUE)
    axis.plot(found.speed * minute, found.viscosity_needed / Pa_s, "o", color=style.INK)
    axis.axvspan(found.limiting.speed * minute, speeds[-1] * minute, color=style.RED, alpha=0.12, lw=0)
    if found.viscosity is not None:
        axis.axhline(found.viscosity / Pa_s, color=style.GREEN, ls=(0, (4, 3)))
    axis.set(title="Viscosity at which resin stays", xlabel="speed [mm/min]", ylabel="least viscosity [Pa·s]",
             xlim=(speeds[0] * minute, speeds[-1] * minute))  # fmt: skip
