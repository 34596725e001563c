"""Both colors optimized together through the kinetics, compared with the patterns of a linear model."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.dualcolor import verdict, words
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.printability import PowerVerdict, Thresholds, TurnDoses
from vamgpu.chemistry.species import Rates
from vamgpu.geometry import Beam, Turntable
from vamgpu.methods.joint import ColorPlan, KineticModel, LinearModel, LossWeights, TwoColorResin, optimize_colors
from vamgpu.operators.projection import Projection
from vamgpu.optics.vat import Vat
from vamgpu.reports import style
from vamgpu.targets.designs import DIAMETER
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ALPHA, PAIRING = 0.2138, 0.432
"""k_B/k_A and k₂·[A]₀ [1/s] as fitted to the measured induction times."""
OUTSIDE = 0.7
"""Greatest effective dose outside the part."""
LABELS = {"visible": "visible alone", "linear": "linear model", "joint": "through the kinetics"}
HUES = dict(zip(LABELS, (style.ORANGE, style.QUIET, style.BLUE), strict=True))


def joint(
    device: Device, quick: bool = False, pixels: int = 80, angles: int = 120, iterations: int = 120, turns: int = 3,
    period: float = 10.0, supply: float = 5.0, firm: float = 1.25,
) -> Picture:  # fmt: skip
    """Words in a round slice of Ø30 mm.

    period: of a turn [s].  supply: [C]₀/[A]₀.  firm: T_mec/T_opt.
    """
    n, poses, count = (40, 24, 6) if quick else (int(pixels), int(angles), int(iterations))
    target = round_slice(n)
    pair = round_colors(target, poses, (0.5, 0.5), device)
    rates = Rates(1.0 / 30.0, ALPHA / 30.0, 1.0 / 30.0, PAIRING, supply=supply)
    resin = TwoColorResin.of(rates, *pair)
    runs = 6 if quick else 12
    model = KineticModel(*pair, resin, int(turns), period=period, runs=runs)
    before = KineticModel(*pair, resin, max(int(turns) - 1, 1), period=period, runs=runs)
    weights = LossWeights(OUTSIDE, firm, firm + 0.25)
    plans = {
        "visible": optimize_colors(LinearModel(*pair, resin, int(turns)), target, replace(weights, share=0.0), count),
        "linear": optimize_colors(LinearModel(*pair, resin, int(turns)), target, weights, count),
        "joint": optimize_colors(model, target, weights, count),
    }
    fractions, near = target.numpy(), target.grid.cylinder()[:, :, None]
    doses = {name: plan.effective_dose(model).numpy() for name, plan in plans.items()}
    found = {name: plan.contrast(model) for name, plan in plans.items()}
    figure = _drawn(plans, doses, fractions, near)
    promised = plans["linear"].contrast()
    rows = tuple((LABELS[name], _row(plan, model, before, firm)) for name, plan in plans.items())
    facts = (
        Fact("window, visible light alone", found["visible"].window, "of D_in,max", 3),
        Fact("window of the linear model's patterns", found["linear"].window, "of D_in,max", 3),
        Fact("window that the linear model predicts", promised.window, "of D_in,max", 3),
        Fact("window of patterns found with the kinetics", found["joint"].window, "of D_in,max", 3),
        Fact("cured outside the part, linear model's patterns", 100 * found["linear"].overcured, "%", 3),
        Fact("cured outside the part, with the kinetics", 100 * found["joint"].overcured, "%", 3),
    )
    header = ("patterns", "D in, least", "D out, most", "window", "bulk", "uncured [%]", "overcured [%]", "D in before "
              "the last turn")  # fmt: skip
    early = sum(values[-1] >= 1.0 for _, values in rows)
    formats = ("+.3f", "+.3f", "+.3f", "+.3f", ".2f", ".2f", ".3f")
    return Picture(figure, _caption(n, poses, model, early), facts, Table(header, formats, rows), plans["joint"].papers)


def _caption(size: int, poses: int, model: KineticModel, early: int) -> str:
    """early: number of cases that pass the end of the induction before the last turn."""
    turns, supply = f"{model.turns} turns of {model.period:g} s", f"{model.resin.supply:g}"
    return (
        "Words in one slice, by visible light that cures and ultraviolet light that inhibits, both optimized "
        "together. The figure shows effective doses: 1 is the end of the induction; inhibitor that ultraviolet adds "
        "counts as visible dose that is still needed. Light arrives in the order of rotation, each color is "
        f"attenuated separately (μR = 0.5), C is used up, and B pairs up in between: α = {ALPHA:g} and k₂ = "
        f"{PAIRING:g}/s are fitted to the measured induction times; [C]₀ = {supply} [A]₀ is assumed. The linear model, "
        "visible − k·ultraviolet, ignores order and decay, so its ultraviolet light often has no lasting effect. The "
        "kinetics, differentiated exactly through all turns, place ultraviolet light where and when its effect lasts. "
        f"In {early} of {len(LABELS)} cases, the greatest dose in the part exceeds 1 before the last turn. Below each "
        "dose, the voxels with dose ≥ 1: correct in black, missing in blue, excess in red; below the part, the "
        f"ultraviolet light found with the kinetics. {size} × {size} voxels, {poses} angles, {turns}."
    )


def round_slice(n: int) -> Target:
    """The words on n × n voxels, all within the circle that these hold, of Ø30 mm."""
    inner = words(round(n / 1.3)).numpy()
    before = (n - inner.shape[0]) // 2
    after = n - inner.shape[0] - before
    return Target.from_array(np.pad(inner, ((before, after), (before, after), (0, 0))), DIAMETER / n, name="words")


def round_colors(
    target: Target, poses: int, extinctions: tuple[float, float], device: Device
) -> tuple[Projection, Projection]:  # fmt: skip
    """Operators of both colors in resin of the slice's radius R, with μR, one voxel per pixel."""
    grid, radius = target.grid, 0.5 * DIAMETER
    beam = Beam((grid.shape[0], 1), grid.pitch)
    vats = (Vat(2.0 * radius, radius=radius, absorption=mu / radius) for mu in extinctions)
    visible, ultraviolet = (Projection(grid, beam, Turntable(poses), vat, device) for vat in vats)
    return visible, ultraviolet


def _drawn(
    plans: dict[str, ColorPlan], doses: dict[str, np.ndarray], fractions: np.ndarray, near: np.ndarray
) -> Figure:  # fmt: skip
    figure, axes = style.sheet("abcd;hefg;iiij", 8.4, height_ratios=(1.0, 1.0, 0.95))
    style.shown(axes["a"], fractions[:, :, 0], "part", cmap=style.SOLID)
    for (top, below), (name, dose) in zip(("be", "cf", "dg"), doses.items(), strict=True):
        style.shown(axes[top], dose[:, :, 0], LABELS[name], vmin=-0.2, vmax=1.5)
        print_ = verdict((dose >= 1.0)[:, :, 0], fractions[:, :, 0] >= 0.5)
        axes[below].imshow(print_.transpose(1, 0, 2), origin="lower", interpolation="nearest")
        style.bare(axes[below])
        axes[below].grid(False)
    style.shown(axes["h"], plans["joint"].ultraviolet.numpy()[:, :, 0], "ultraviolet light", cmap=style.LIGHT)
    axes["h"].set(xlabel="angle θ", ylabel="r", aspect="auto")
    _spread(axes["i"], doses, fractions, np.broadcast_to(near, fractions.shape))
    for name, plan in plans.items():
        axes["j"].semilogy([s.loss for s in plan.history], color=HUES[name], label=LABELS[name])
    axes["j"].set(title="Loss over iterations", xlabel="iteration")
    return figure


def _row(plan: ColorPlan, model: KineticModel, before: KineticModel, firm: float) -> tuple[float, ...]:
    got = plan.contrast(model)
    early = plan.contrast(before)
    at = PowerVerdict.of(TurnDoses(early.in_least, early.in_most, early.out_most),
                    TurnDoses(got.in_least, got.in_most, got.out_most), Thresholds(1.0, firm))  # fmt: skip
    return (got.in_least, got.out_most, got.window, got.bulk, 100 * got.uncured, 100 * got.overcured, 1.0 - at.early)


def _spread(axis: Axes, doses: dict[str, np.ndarray], fractions: np.ndarray, near: np.ndarray) -> None:
    edges = np.linspace(-1.0, 2.0, 121)
    for name, dose in doses.items():
        for inside, line in ((True, "-"), (False, ":")):
            chosen = near & ((fractions >= 0.5) == inside)
            share = np.histogram(dose[chosen], edges)[0] / chosen.sum()
            axis.step(edges[:-1], share, line, where="post", color=HUES[name],
                      label=LABELS[name] if inside else None)  # fmt: skip
    axis.axvline(1.0, ymax=0.88, color=style.INK, lw=1)
    axis.legend(loc="upper left", ncols=3)
    axis.set(yscale="log", xlim=(-0.3, 1.8), ylim=(1e-4, 1), xlabel="effective dose", ylabel="share of voxels",
             title="Voxels in the part (lines) and out of it (dots)")  # fmt: skip
