"""When a part prints: doses of a turn against the two thresholds, for one color and for two."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.joint import round_colors, round_slice
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.exposure_plan import TurnLight, disturbances, plan_exposure
from vamgpu.chemistry.printability import (
    Thresholds,
    TurnDoses,
    most_turns,
    power_window,
    static_inhibition,
)
from vamgpu.chemistry.species import PAPER
from vamgpu.methods import optimize
from vamgpu.methods.joint import LinearModel, LossWeights, TwoColorResin, optimize_colors
from vamgpu.reports import style
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLAIN = TwoColorResin(visible=1.0, ultraviolet=1.0, supply=0.5, alpha=1.0)
"""Of the linear model with k = 1."""


@dataclass(frozen=True)
class _Scene:
    """A panel of Fig. 7: doses of a turn at a power, the number of turns, and thresholds."""

    title: str
    doses: TurnDoses
    thresholds: Thresholds
    turns: int
    power: float


def printability(
    device: Device, quick: bool = False, pixels: int = 120, angles: int = 180, turns: int = 3, critical: float = 0.1,
    firm: float = 1.25, visible: float = 0.5, uv: float = 0.5, off: float = 0.02, axis: float = 0.01,
    limit: float = 50.0,
) -> Picture:  # fmt: skip
    """Words in a round slice of Ø30 mm.

    critical: T_opt [mJ/mm³]. firm: T_mec over it. visible, uv: μR. off: allowed error of the dose (share), and of the
    axis [mm]. limit: a full-on pixel [mW/cm²].
    """
    n, poses, count = (40, 36, 30) if quick else (int(pixels), int(angles), 400)
    target, resin = round_slice(n), Thresholds(critical, firm * critical)
    one, two = _lights(target, poses, count, device, (visible, uv))
    fractions = target.on(device)
    single, dual = (turn.doses(fractions)[0] for turn in (one, two))
    cases = disturbances(dose=off, axis=axis)
    worst = {"one color": TurnDoses.worst(*one.doses(fractions, cases)),
             "two colors": TurnDoses.worst(*two.doses(fractions, cases))}  # fmt: skip
    every = {"one color": single, "two colors": dual}
    scenes = _scenes(single, dual, resin, int(turns))
    figure, last = _drawn(scenes, every, worst, resin), scenes[-1]
    window = power_window(dual, resin, int(turns))
    plan = plan_exposure(two, int(turns), window.middle, visible_limit=limit, ultraviolet_limit=limit)
    facts = (
        Fact("D_in,min over D_out,max, one color", single.in_least / max(single.out_most, 1e-9), "", 3),
        Fact("D_in,min over D_out,max, two colors", dual.in_least / max(dual.out_most, 1e-9), "", 3, firm,
             "T_mec/T_opt, from (b) and (c)", "≥"),
        Fact("D_in,min over D_in,max, two colors", dual.in_least / dual.in_most, "", 3),
        Fact("greatest allowed number of turns, one color", float(most_turns(single, resin)), "", 3),
        Fact("greatest allowed number of turns, two colors", float(min(most_turns(dual, resin), 999)), "", 3),
        Fact(f"tolerance of the power to either side at {turns:.0f} turns, two colors", 100 * window.tolerance, "%", 3),
        Fact("the same, worst case of the disturbances", 100 * power_window(worst["two colors"], resin,
             int(turns)).tolerance, "%", 3),
        Fact("exposure", plan.seconds, "s", 4),
        Fact("brightest visible pixel", plan.visible_peak, "mW/cm²", 4, limit, "projector", "≤"),
        Fact("brightest ultraviolet pixel", plan.ultraviolet_peak, "mW/cm²", 4, limit, "projector", "≤"),
    )  # fmt: skip
    table = _table(every, worst, resin, int(turns))
    caption = (
        "The powers and numbers of turns at which a part prints, with one color of light and with two. The upper "
        "panels show doses after every turn of all points of the part (blue, D_in,min to D_in,max) and of the outside "
        f"point that gets most (red), divided by T_opt; the dashed line is T_mec = {firm:g} T_opt. Three conditions "
        "hold for a print: (a) before the last turn, no point of the part exceeds T_opt; (b) after it, all points "
        "exceed T_mec; (c) no point outside exceeds T_opt. Panels a to e, as in the paper's Fig. 7: two colors at an "
        "allowed power; one color with enough power to be firm, and with little enough not to overcure; two colors in "
        f"one turn; one color with more inhibitor, {last.turns} turns and {last.power / scenes[2].power:g} times the "
        "power of panel c. Below, the allowed power against the number of turns; pale: the range that also tolerates "
        f"± {100 * off:g} % in each lamp and ± {axis:g} mm in the axis, in all combinations. The slice has {n} × {n} "
        f"voxels and {poses} angles; doses are linear, visible − uv; the patterns of one color are those of L-BFGS. "
        f"T_opt = {critical:g} mJ/mm³ is assumed, not measured; 999 stands for any number of turns."
    )
    return Picture(figure, caption, facts, table, (PAPER,))


def _drawn(
    scenes: tuple[_Scene, ...], every: dict[str, TurnDoses], worst: dict[str, TurnDoses], resin: Thresholds
) -> Figure:  # fmt: skip
    figure, axes = style.sheet("abcde;fffgg", 6.4, height_ratios=(1.0, 1.15))
    for letter, scene in zip("abcde", scenes, strict=True):
        _turns(axes[letter], scene, resin.optical)
    _map(axes["f"], every, worst, resin)
    _extremes(axes["g"], every, worst)
    return figure


def _table(every: dict[str, TurnDoses], worst: dict[str, TurnDoses], resin: Thresholds, turns: int) -> Table:
    rows = []
    for name, doses in every.items():
        for label, value in ((name, doses), (f"{name}, worst case", worst[name])):
            found = power_window(value, resin, turns)
            rows.append((label, (value.in_least / value.in_most, value.out_most / value.in_most,
                                 100 * found.tolerance, float(min(most_turns(value, resin), 999)))))  # fmt: skip
    header = ("light", "D in, least / most", "D out, most / D in, most", f"tolerance of the power at {turns} turns [%]",
              "most turns")  # fmt: skip
    return Table(header, (".3f", "+.3f", ".1f", ".0f"), tuple(rows))


def _lights(
    target: Target, poses: int, count: int, device: Device, extinctions: tuple[float, float]
) -> tuple[TurnLight, TurnLight]:  # fmt: skip
    """Patterns of one color, and of two."""
    A, B = round_colors(target, poses, extinctions, device)
    weights = LossWeights(outside=0.45, inside=1.0 + 1e-3, most=1.06)
    found = optimize_colors(LinearModel(A, B, PLAIN, 1), target, weights, count)
    single = optimize(A, target, "lbfgs", iterations=max(count // 6, 20))
    return TurnLight(A, single.sinogram), TurnLight(A, found.visible, B, found.ultraviolet, PLAIN.subtraction)


def _scenes(single: TurnDoses, dual: TurnDoses, resin: Thresholds, turns: int) -> tuple[_Scene, ...]:
    good, bare = power_window(dual, resin, turns), power_window(single, resin, turns)
    shy = 0.97 * resin.optical / (turns * max(single.out_most, 1e-9))
    tried = ((n, times * shy) for times in range(1, 11) for n in range(1, 41))
    more, power = next((each for each in tried if static_inhibition(single, resin, *each).legal), (40, shy))
    shift = static_inhibition(single, resin, more, power)
    later = resin.delayed(max(0.5 * (shift.low + shift.high), 0.0))
    return (
        _Scene("a  two colors", dual, resin, turns, good.middle if good.legal else 1.05 * good.low),
        _Scene("b  one, firm", single, resin, turns, 1.05 * bare.low),
        _Scene("c  one, no overcure", single, resin, turns, shy),
        _Scene("d  two, one turn", dual, resin, 1, power_window(dual, resin, 1).middle),
        _Scene("e  more inhibitor", single, later, more, power),
    )


def _turns(axis: Axes, scene: _Scene, critical: float) -> None:
    number = np.arange(scene.turns + 1)
    doses, scale = scene.doses, scene.power / critical
    low, high, out = (number * scale * value for value in (doses.in_least, doses.in_most, doses.out_most))
    axis.fill_between(number, low, high, color=style.BLUE, alpha=0.3, lw=0)
    axis.plot(number, low, color=style.BLUE)
    axis.plot(number, out, color=style.RED)
    axis.axhline(scene.thresholds.optical / critical, color=style.INK, lw=1)
    axis.axhline(scene.thresholds.mechanical / critical, color=style.INK, lw=1, ls="--")
    axis.set(title=scene.title, xlabel="turns", xlim=(0, scene.turns), ylim=(0, None))
    axis.title.set_fontsize(8.5)


def _map(
    axis: Axes, every: dict[str, TurnDoses], worst: dict[str, TurnDoses], resin: Thresholds
) -> None:  # fmt: skip
    most = 8
    number = np.arange(1, most + 1)
    for (name, doses), color in zip(every.items(), (style.ORANGE, style.BLUE), strict=True):
        unit = doses.in_least / resin.mechanical
        for value, alpha in ((worst[name], 0.35), (doses, 0.95)):
            found = [power_window(value, resin, int(k)) for k in number]
            for k, window in zip(number, found, strict=True):
                if window.legal:
                    high = min(window.high, 3.0 * window.low)
                    axis.plot([k, k], [k * window.low * unit, k * high * unit], color=color, alpha=alpha,
                              lw=9 if alpha < 0.5 else 4, solid_capstyle="butt")  # fmt: skip
        axis.plot([], [], color=color, lw=4, label=name)
    axis.axhline(1.0, color=style.QUIET, lw=1)
    axis.legend(loc="upper right")
    axis.set(xlabel="turns", ylabel="turns × power × D_in,min / T_mec", title="Allowed powers over the number of turns",
             xlim=(0.4, most + 0.6), ylim=(0.98, None))  # fmt: skip


def _extremes(axis: Axes, every: dict[str, TurnDoses], worst: dict[str, TurnDoses]) -> None:
    for row, (name, doses) in enumerate(every.items()):
        for value, shift, alpha in ((doses, 0.12, 1.0), (worst[name], -0.12, 0.4)):
            scale = 1.0 / doses.in_most
            axis.plot([value.in_least * scale, value.in_most * scale], [row + shift] * 2, color=style.BLUE, lw=7,
                      alpha=alpha, solid_capstyle="butt")  # fmt: skip
            axis.plot(value.out_most * scale, row + shift, "o", color=style.RED, alpha=alpha)
    axis.set(yticks=range(len(every)), yticklabels=list(every), xlabel="dose of a turn / D_in,max", ylim=(-0.5, 1.5),
             title="D in, greatest D out; worst case pale")  # fmt: skip
