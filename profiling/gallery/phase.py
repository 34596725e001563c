"""Phase portraits of two inhibitors under two colors: where light drives them, and their stationary states."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.chemistry.efficiency import RotatingLight
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.phase_plane import drift, nullcline, stationary
from vamgpu.chemistry.species import PAPER, LightCycle, Rates, SpeciesState
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STARTS = ((1.0, 0.0), (1.0, 0.6), (0.55, 1.25), (1.0, 1.25), (0.1, 0.15), (0.15, 1.25))
TOP = 1.3
LONG = 600.0
TURNS = 3
"""Values in the title of the third panel."""


@dataclass(frozen=True)
class _Case:
    """Constant light, and its effect."""

    rates: Rates
    uv: float

    def drifts(self, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return drift(self.rates, a, b, 1.0, self.uv)[:2]


def phase(
    device: Device,
    quick: bool = False,
    alpha: float = 0.6,
    beta: float = 0.6,
    pairing: float = 0.02,
    induction_s: float = 30.0,
    period_s: float = 12.0,
    radius: float = 12.0,
) -> Picture:
    """Fig. 3 of the photoinhibition paper. Concentrations are in units of [A] before printing."""
    k_a = 1.0 / induction_s
    rates = Rates(k_a, alpha * k_a, k_a, pairing, supply=40.0, order=0)
    part, outside = _Case(rates, 0.0), _Case(rates, beta)
    figure, axes = style.sheet("ab;cd", 8.6, height_ratios=[1.2, 1])
    speed = _portrait(axes["a"], part, device, quick, "In-part, visible light only: to the origin")
    _portrait(axes["b"], outside, device, quick, f"Out-of-part, β = {beta:g}: to the stationary state")
    style.bar(speed, [axes["a"], axes["b"]], "speed [1/s]")
    _turning(axes["c"], rates, beta, period_s, radius, device)
    _rates_of_return(axes["d"], rates)
    held = stationary(rates, 1.0, beta)
    facts = _origin_facts(rates, device)
    if held is not None:
        facts += _held_facts(rates, beta, held.b, held.eigenvalues, device)
    caption = (
        "Visible light uses up both inhibitors; UV makes the second. Arrows show the direction in which a state moves, "
        "and their color its speed; the dashed line shows where [B] is stationary ([A] is stationary only on the left "
        "edge). Without UV all paths end at the origin, where polymerization begins. With enough of it, β > α/2, there "
        "is one stationary state away from the origin; both its eigenvalues are real and negative, so it is a stable "
        "node. The paper's text mentions an oscillating center; there is none at any light level, because [A] never "
        "grows. Below: a point off the axis of a turning vial over three turns, with and without UV; and the two rates "
        "at which disturbances decay."
    )
    return Picture(figure, caption, facts, None, (PAPER,))


def _portrait(axis: Axes, case: _Case, device: Device, quick: bool, title: str):  # noqa: ANN202
    n = 12 if quick else 19
    a, b = np.meshgrid(np.linspace(0.02, 1.05, n), np.linspace(0.02, TOP, n))
    first, second = case.drifts(a, b)
    speed = np.hypot(first, second)
    scale = np.maximum(speed, 1e-12)
    drawn = axis.quiver(a, b, first / scale, second / scale, speed, cmap="viridis", scale=26, width=0.0035, pivot="mid")
    drawn.set_clim(0.0, 0.08)
    level = np.linspace(1e-3, TOP, 400)
    axis.plot(nullcline(case.rates, level, 1.0, case.uv), level, color=style.INK, lw=1.2, ls=(0, (4, 3)))
    starts = SpeciesState([s[0] for s in STARTS], [s[1] for s in STARTS], 40.0)
    course = advance(
        case.rates, starts, LightCycle(1.0, case.uv, [0.5]), intervals=int(2 * LONG), rows=401, device=device
    )
    for path in course.path[0]:
        axis.plot(path[:, 0], path[:, 1], color=style.BLUE, lw=1.3)
    axis.plot(*zip(*STARTS, strict=True), "o", color=style.BLUE, ms=3.5)
    held = stationary(case.rates, 1.0, case.uv)
    axis.plot(0.0, held.b if held else 0.0, "o", color=style.RED, ms=8, clip_on=False, zorder=5)
    axis.set(title=title, xlabel="[A] / [A]₀", ylabel="[B] / [A]₀", xlim=(-0.02, 1.08), ylim=(-0.02, TOP + 0.02))
    return drawn


def _turning(axis: Axes, rates: Rates, beta: float, period: float, radius: float, device: Device) -> None:
    """Three turns of a point off the axis: distance from the origin, with and without UV."""
    light = RotatingLight(visible=1.0, uv=beta, visible_extinction=0.02, uv_extinction=0.06, period=period)
    fine = 4
    for uv, hue, name in ((beta, style.RED, "out-of-part: both colors"), (0.0, style.BLUE, "in-part: visible only")):
        turn = light.at([radius])
        dosed = LightCycle(turn.visible, (uv / beta if beta else 0.0) * np.asarray(turn.uv), turn.seconds)
        count = TURNS * light.poses
        path = advance(rates, rates.start(), dosed, intervals=count, rows=count // fine + 1, device=device).path[0, 0]
        time = np.arange(len(path)) * fine * period / light.poses
        axis.plot(time, np.hypot(path[:, 0], path[:, 1]), color=hue, label=name)
        axis.plot(time, path[:, 0], color=hue, lw=1.0, ls=(0, (1, 1.5)))
    for turn in range(1, TURNS):
        axis.axvline(turn * period, color=style.FAINT, lw=1.0)
    axis.legend(loc="lower left")
    axis.set(title=f"Three turns at {radius:g} mm from the axis ([A] dotted)", xlabel="time [s]",
             ylabel="distance from the origin / [A]₀",
             ylim=(0, None), xlim=(0, TURNS * period))  # fmt: skip


def _rates_of_return(axis: Axes, rates: Rates) -> None:
    betas = 0.5 * rates.alpha * (1.0 + np.geomspace(1e-3, 6.0, 200))
    found = [stationary(rates, 1.0, float(beta)) for beta in betas]
    values = -np.array([s.eigenvalues if s else (np.nan, np.nan) for s in found])
    direct = -np.array([np.diag(s.jacobian) if s else (np.nan, np.nan) for s in found])
    axis.semilogy(betas, direct[:, 0], color=style.BLUE, label="of [A]: k_A·I_vis/[B]")
    axis.semilogy(betas, direct[:, 1], color=style.ORANGE, label="of [B]: 4k₂[B]")
    axis.semilogy(betas, values.min(axis=1), color=style.INK, lw=0.9, ls=(0, (1, 1.5)))
    axis.axvspan(0.0, 0.5 * rates.alpha, color=style.FAINT, alpha=0.5, lw=0)
    axis.text(0.25 * rates.alpha, 0.05, "none", ha="center", transform=axis.get_xaxis_transform(), fontsize=8.5)
    axis.legend()
    axis.set(title="Rates at which disturbances fade", xlabel="β = k_C·I_UV / (k_A·I_vis)", ylabel="[1/s]",
             xlim=(0.0, betas[-1]))  # fmt: skip


def _origin_facts(rates: Rates, device: Device) -> tuple[Fact, ...]:
    from scipy.integrate import solve_ivp

    start = SpeciesState(1.0, 0.6, 40.0)
    event = float(advance(rates, start, LightCycle(1.0, 0.0, LONG), device=device).event[0, 0])

    def change(_: float, y: np.ndarray) -> list[float]:
        slope = drift(rates, max(y[0], 0.0), max(y[1], 0.0), 1.0, 0.0)
        return [float(slope[0]), float(slope[1])]

    def gone(_: float, y: np.ndarray) -> float:
        return y[0] + y[1] - 1e-6

    gone.terminal = True  # type: ignore[attr-defined]
    fine = solve_ivp(change, (0.0, LONG), (1.0, 0.6), "Radau", events=gone, rtol=1e-10, atol=1e-13)
    edge, shares = 0.5 * rates.alpha, np.linspace(0.98, 1.02, 40)
    plenty = 1e4
    resins = [replace(rates, k_c=share * edge * rates.k_a, supply=plenty) for share in shares]
    ends = advance(resins, SpeciesState(1.0, 0.0, plenty), LightCycle(1.0, 1.0, 200.0 * LONG), device=device)
    last = edge * float(shares[ends.depleted[:, 0]].max(initial=0.0))
    return (
        Fact("time to the origin from [A] = 1, [B] = 0.6 without UV", event, "s", 6, float(fine.t_events[0][0]),
             "SciPy, rtol 1e-10"),
        Fact("largest β, in steps of 0.1 %, whose path ends at the origin", last, "", 4, edge, "α/2"),
    )  # fmt: skip


def _held_facts(rates: Rates, uv: float, level: float, eigenvalues: np.ndarray, device: Device) -> tuple[Fact, ...]:
    """The closed forms compared with the ends of paths, and the decay of small disturbances."""
    end = advance(rates, SpeciesState(1.0, 0.0, 40.0), LightCycle(1.0, uv, LONG), device=device)
    off, span = 1e-2 * level, 1.0
    pushed = advance(rates, SpeciesState([off, 0.0, 0.0], [level - off, level + off, level - off], 40.0),
                     LightCycle(1.0, uv, span), device=device)  # fmt: skip
    of_a = float(np.log(off / pushed.a[0, 0]) / span)
    of_b = float(np.log(2.0 * off / (pushed.b[0, 1] - pushed.b[0, 2])) / span)
    slow, fast = sorted((of_a, of_b))
    return (
        Fact("[B] where paths end", float(end.b[0, 0]), "[A]₀", 5, level, "closed form"),
        Fact("slower rate of return, measured", slow, "1/s", 4, float(-eigenvalues.max()), "closed form"),
        Fact("faster rate of return, measured", fast, "1/s", 4, float(-eigenvalues.min()), "closed form"),
        Fact("product of the rates of return, measured", of_a * of_b, "1/s²", 4, 4 * rates.k_2 * rates.k_a, "eq. 9"),
    )
