"""Effects of UV: efficiency against light, extinction, lifetime of the radical and radius, and the dose needed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.efficiency import RotatingLight, efficiency_at, exact_efficiency, uv_needed
from vamgpu.chemistry.induction import MEASURED, NAMES, Fit, fit_induction
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.species import PAPER, LightCycle, Rates, SpeciesState
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHARES = (0.0, 0.25, 0.5, 0.75, 0.97)
"""Radii relative to that of the vial."""
PAIRINGS = (0.0, 0.01, 0.05)
"""k₂ [1/([A]₀·s)] of the lines of S1."""
KNOWN = (30.0, 39.1, 49.2, 68.0)
"""Induction times that eqs 5–7 can reach."""


def efficiency(
    device: Device,
    quick: bool = False,
    vial: float = 15.0,
    induction_s: float = 40.0,
    alpha: float = 1.0,
    beta: float = 0.2,
    pairing: float = 0.02,
    period_s: float = 20.0,
    extinction: float = 0.06,
) -> Picture:
    """Figs S1–S4 of the photoinhibition paper as trends, and its four induction times."""
    k_a = 1.0 / induction_s
    rates = Rates(k_a, alpha * k_a, k_a, pairing, supply=50.0, order=0)
    light = RotatingLight(vial, 1.0, beta, 0.5 * extinction, extinction, period_s, 36 if quick else 72)
    figure, axes = style.sheet("ab;cd;ee", 10.2, height_ratios=[1, 1, 0.62])
    _constant_light(axes["a"], rates, device, quick)
    spread = _by_extinction(axes["b"], rates, light, device, quick)
    by_life = _by_life(axes["c"], rates, light, device, quick)
    doses = _uv_dose(axes["d"], rates, light, device, quick)
    fit = fit_induction(device=device if device.name != "numpy" else "warp:cpu")
    _induction(axes["e"], fit)
    ripple, mean = np.ptp(spread, axis=1), spread.mean(axis=1)
    half = _constant(rates, 0.25 * alpha, 0.0, device)
    stored = _constant(replace(rates, k_c=0.0), 0.0, 0.6 * alpha, device)
    facts = (
        Fact("W at β = α/4, without pairing", half, "", 5, 1.0, "exact"),
        Fact("W of [B]₀ = 0.6·α·[A]₀, without UV or pairing", stored, "", 5, exact_efficiency(alpha, 0.0, 0.6 * alpha),
             "exact"),
        Fact("W at the rim over W on the axis", float(mean[-1] / mean[0]), "", 4, 1.0, "S2: falls inwards", "≥"),
        Fact("ripple of W with the starting angle, at the rim", float(ripple[-1]), "", 3, float(ripple[:-1].max()),
             "S2: largest at the rim", "≥"),
        Fact("W on the axis, longest over shortest life", float(by_life[0, 0] / by_life[0, -1]), "", 3, 1.0,
             "S3: a shorter life lowers W", "≥"),
        Fact("UV dose for W = 1 on the axis, most over least extinction", float(doses[-1, 0] / doses[0, 0]), "", 3,
             1.0, "S4: extinction costs dose", "≥"),
        *(Fact(f"induction, {name}", time, "s", 4, wanted, "paper")
          for name, time, wanted in zip(NAMES, fit.times, fit.measured, strict=True)),
        Fact("root mean square of the errors with UV", fit.rms, "s", 3, _rms(KNOWN), "known to be reachable", "≤"),
        Fact("α fitted", fit.rates.alpha, "", 3),
        Fact("k₂ fitted", fit.rates.k_2, "1/([A]₀·s)", 3),
        Fact("k_C·I_UV fitted, at the end of its range" if "k_c" in fit.bound else "k_C·I_UV fitted", fit.rates.k_c,
             "[A]₀/s", 3),
    )  # fmt: skip
    rows = tuple((f"{share * vial:.1f} mm", (float(m), float(r), float(d)))
                 for share, m, r, d in zip(SHARES, mean, ripple, doses[1], strict=True))  # fmt: skip
    table = Table(("radius", "W, mean over starting angles", "W, range", "UV dose for W = 1 [t₀·I_vis]"),
                  (".4f", ".2g", ".4f"), rows)  # fmt: skip
    caption = (
        "W is the induction that UV adds, in units of the induction without it. Under constant light and without "
        "pairing it is 2β/(α − 2β), dashed. In a turning vial, light weakens on its way in, here UV more than visible "
        "light; W therefore falls towards the axis. The light at a point near the rim changes most within a turn; W "
        "there depends on the starting angle. Inhibitor radicals that pair up sooner are lost, so a shorter life "
        "lowers W. The paper's Figs S1–S4 are not in its text, so only their trends are compared. Below: three "
        "constants fitted to its only kinetic data. The fit drives the production of B to its maximum: k_C ends at the "
        "limit of its range, and errors of up to a second remain."
    )
    return Picture(figure, caption, facts, table, (PAPER,))


def _constant(rates: Rates, beta: float, stored: float, device: Device) -> float:
    """W under constant light, without pairing."""
    start, light = SpeciesState(1.0, stored, rates.supply), LightCycle(1.0, beta, 20.0 / rates.k_a)
    course = advance(replace(rates, k_2=0.0), start, light, device=device)
    return float(course.efficiency[0, 0])


def _constant_light(axis: Axes, rates: Rates, device: Device, quick: bool) -> None:
    """S1: W against β for several α and lives of B."""
    shares = np.linspace(0.0, 0.9, 12 if quick else 40)
    for alpha, hue in ((0.5 * rates.alpha, style.BLUE), (rates.alpha, style.ORANGE), (2.0 * rates.alpha, style.GREEN)):
        betas = 0.5 * alpha * shares
        exact = [exact_efficiency(alpha, float(b)) for b in betas]
        axis.plot(betas, exact, color=style.INK, ls=(0, (2, 3)), lw=1.0, zorder=4)
        resins = [replace(rates, k_b=alpha * rates.k_a, k_c=float(b) * rates.k_a, k_2=k_2)
                  for k_2 in PAIRINGS for b in betas]  # fmt: skip
        course = advance(
            resins, SpeciesState(1.0, 0.0, rates.supply), LightCycle(1.0, 1.0, 40.0 / rates.k_a), device=device
        )
        found = np.where(course.depleted, course.efficiency, np.nan).reshape(3, -1)
        for line, width in zip(found, (2.2, 1.4, 0.8), strict=True):
            axis.plot(betas, line, color=hue, lw=width, label=f"α = {alpha:g}" if width > 2 else None)
    axis.legend(title="k₂ = " + ", ".join(f"{k_2:g}" for k_2 in PAIRINGS) + " (thin)", title_fontsize=8.5,
                loc="upper right")  # fmt: skip
    axis.set(title="S1: constant light (dashed: exact)", xlabel="β", ylabel="W", ylim=(0, 4),
             xlim=(0, 1.4 * rates.alpha))  # fmt: skip


def _by_extinction(axis: Axes, rates: Rates, light: RotatingLight, device: Device, quick: bool) -> np.ndarray:
    """S2: W against extinction at five radii, for random starting angles; W for the vial's light, (radii, angles)."""
    rng, angles = np.random.default_rng(0), 8 if quick else 24
    phases = 2.0 * np.pi * (np.arange(angles) + rng.random(angles)) / angles
    radius, phase = (v.ravel() for v in np.meshgrid(np.multiply(SHARES, light.vial), phases, indexing="ij"))

    def at(extinction: float) -> np.ndarray:
        weakened = replace(light, visible_extinction=0.5 * extinction, uv_extinction=extinction)
        return efficiency_at(rates, weakened, radius, phase, device=device)[0].reshape(len(SHARES), -1)

    own = at(light.uv_extinction)
    values = np.linspace(0.0, 2.0 * light.uv_extinction, 4 if quick else 9)
    clouds = [at(float(value)) for value in values]
    for row, share in enumerate(SHARES):
        hue = style.HUES[row]
        for value, cloud in zip(values, clouds, strict=True):
            axis.plot(np.full(angles, value), cloud[row], ".", color=hue, ms=3, alpha=0.6)
        axis.plot(values, [cloud[row].mean() for cloud in clouds], color=hue, lw=1.1,
                  label=f"{share * light.vial:.1f} mm")  # fmt: skip
    axis.legend(fontsize=8)
    axis.set(title="S2: extinction, from angles at random", ylabel="W",
             xlabel="extinction of UV [1/mm]; of visible light half of it")  # fmt: skip
    return own


def _by_life(axis: Axes, rates: Rates, light: RotatingLight, device: Device, quick: bool) -> np.ndarray:
    """S3: W against the half-life of [B] = [A]₀ at three radii, (radii, lives); the last is the shortest."""
    lives = np.geomspace(1000.0, 2.0, 6 if quick else 16)
    radii = np.multiply(SHARES[::2], light.vial)
    resins = [replace(rates, k_2=1.0 / (2.0 * life)) for life in lives]
    found = efficiency_at(resins, light, radii, device=device).T
    for row, radius in enumerate(radii):
        axis.semilogx(lives, found[row], color=style.HUES[2 * row], label=f"{radius:.1f} mm")
    axis.legend(fontsize=8)
    axis.set(title="S3: life of B", xlabel="half-life 1/(2k₂[A]₀) [s]", ylabel="W", ylim=(0, None))
    return found


def _uv_dose(axis: Axes, rates: Rates, light: RotatingLight, device: Device, quick: bool) -> np.ndarray:
    """S4: UV dose at the wall for W = 1 over the visible dose of an induction there, (extinctions, radii)."""
    extinctions = [factor * light.uv_extinction for factor in (0.5, 1.0, 1.5)]
    doses = []
    for extinction, hue in zip(extinctions, style.HUES, strict=False):
        weakened = replace(light, visible_extinction=0.5 * extinction, uv_extinction=extinction)
        _, dose = uv_needed(rates, weakened, np.multiply(SHARES, light.vial), device=device)
        doses.append(dose * rates.k_a / rates.oxygen)
        axis.plot(np.multiply(SHARES, light.vial), doses[-1], "o-", color=hue, ms=3.5, label=f"{extinction:g} /mm")
    axis.legend(title="extinction of UV", title_fontsize=8.5, fontsize=8)
    axis.set(title="S4: UV dose for W = 1", xlabel="radius [mm]", ylabel="dose at the wall [t₀·I_vis]", ylim=(0, None))
    return np.array(doses)


def _induction(axis: Axes, fit: Fit) -> None:
    rows = np.arange(len(NAMES))[::-1]
    axis.barh(rows + 0.2, fit.measured, height=0.36, color=style.FAINT, label="measured (paper)")
    axis.barh(rows - 0.2, fit.times, height=0.36, color=style.BLUE, label="eqs 5–7, fitted")
    for row, measured, time in zip(rows, fit.measured, fit.times, strict=True):
        axis.text(measured, row + 0.2, f" {measured:.0f}", va="center", fontsize=8.5)
        axis.text(time, row - 0.2, f" {time:.1f}", va="center", fontsize=8.5)
    axis.legend(loc="upper right")
    axis.set(title="Induction times: three constants for three times", xlabel="time under visible light [s]",
             yticks=rows, yticklabels=NAMES)  # fmt: skip
    axis.grid(False, axis="y")


def _rms(times: tuple[float, ...]) -> float:
    return float(np.sqrt(np.mean(np.square(np.subtract(times, MEASURED)[1:]))))
