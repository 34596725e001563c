"""Rays through media of varying index, compared with formulas, and the convergence of the steppers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.optics.index_field import FormulaField, IndexField, fish_eye, parabolic
from vamgpu.optics.march import ORDERS, march
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHARMA = "Sharma, Kumar, Ghatak: Tracing rays through graded-index media, Applied Optics 21 (1982)"
YOSHIDA = "Yoshida: Construction of higher order symplectic integrators, Physics Letters A 150 (1990)"


def eikonal(device: Device, quick: bool = False, steps: int = 256, index: float = 1.5, slope: float = 0.4) -> Picture:
    """Lenses of radius 1; index and slope [1/mm] of the parabolic medium."""
    figure, axes = style.sheet("ab;cd", 8.4)
    facts = [*_luneburg(axes["a"], device, steps), *_fish_eye(axes["b"], device, 1000 if quick else 2000),
             *_parabolic(axes["c"], device, index, slope), *_slopes(axes["d"], 3 if quick else 5)]  # fmt: skip
    caption = (
        "Rays are marched with d²R/dt² = ½∇n², dt = ds/n. In a Luneburg lens parallel rays meet on the rim; in "
        "Maxwell's fish-eye all rays from a point are closed circles through its image; if n² falls with the square of "
        "x, rays oscillate with a period of 2π·cosθ/g at any amplitude. Errors relative to 8,192 steps fall with the "
        "fourth power of the step for the schemes of Sharma and Yoshida, and with the second for the leapfrog; the "
        "last two are symplectic and keep their energy over any number of steps."
    )
    return Picture(figure, caption, tuple(facts), papers=(SHARMA, YOSHIDA))


def _background(axis: Axes, field: IndexField, x: tuple[float, float], y: tuple[float, float], limit: float) -> None:
    """The index in blue, inside a radius."""
    across, up = np.linspace(*x, 240), np.linspace(*y, 240)
    place = np.stack([g.ravel() for g in (*np.meshgrid(across, up, indexing="ij"), np.zeros((240, 240)))], axis=1)
    index = np.sqrt(np.maximum(field.evaluate(place)[1], 0.0))
    shown = np.where(np.hypot(place[:, 0], place[:, 1]) <= limit, index, np.nan)
    axis.imshow(shown.reshape(240, 240).T, origin="lower", extent=(*x, *y), cmap="Blues", alpha=0.55, aspect="auto")
    axis.grid(False)


def _luneburg(axis: Axes, device: Device, steps: int) -> list[Fact]:
    lens, p = FormulaField((1.0, 1.0, 1.0), (2.0, -1.0)), np.linspace(-0.95, 0.95, 21)
    place = np.stack([-np.sqrt(1.0 - p**2), p], axis=1)
    time = 0.5 * np.pi
    rays = march(lens, place, np.tile([1.0, 0.0], (21, 1)), step=time / steps, until=time, rows=65, device=device)
    _background(axis, lens, (-1.4, 1.2), (-1.1, 1.1), 1.0)
    for path in rays.path:
        axis.plot(np.append(-1.4, path[:, 0]), np.append(path[0, 1], path[:, 1]), color=style.ORANGE, lw=1.0)
    axis.set(title="Luneburg lens", xlabel="x over R", ylabel="y over R", aspect="equal")
    miss = float(np.linalg.norm(rays.place - [1.0, 0.0, 0.0], axis=1).max())
    limit = 1e-8 if device.real == np.float64 else 1e-5
    return [Fact(f"Luneburg: largest distance from the focus, {steps} steps, in R", miss, "", 2, limit, bound="≤")]


def _fish_eye(axis: Axes, device: Device, steps: int) -> list[Fact]:
    lens, r, theta = fish_eye(1.0), 0.6, np.radians(np.arange(50, 131, 16))
    closed = []
    _background(axis, lens, (-3.0, 3.0), (-3.0, 3.0), 9.0)
    for angle in theta:
        # Circles through (r, 0) and its image (−1/r, 0): the center lies on the line halfway between.
        middle = 0.5 * (r - 1.0 / r)
        center = np.array([middle, (r - middle) * np.cos(angle) / np.sin(angle)])
        radius = float(np.hypot(r - middle, center[1]))
        around = np.linspace(0.0, 2.0 * np.pi, 4096, endpoint=False)
        square = (center[0] + radius * np.cos(around)) ** 2 + (center[1] + radius * np.sin(around)) ** 2
        period = 2.0 * np.pi * radius * float(np.mean(1.0 + square)) / 2.0
        out = np.array([[-center[1], -(r - middle)]])  # at right angles to the radius
        rays = march(lens, [[r, 0.0]], out, step=period / steps, until=period, rows=101, device=device)
        closed.append(float(np.abs(np.hypot(*(rays.path[0, :, :2] - center).T) / radius - 1.0).max()))
        axis.plot(*rays.path[0, :, :2].T, color=style.ORANGE, lw=1.0)
    axis.plot([r, -1.0 / r], [0.0, 0.0], "o", color=style.RED, ms=4)
    axis.set(title="Maxwell's fish-eye", xlabel="x over R", ylabel="y over R", aspect="equal")
    axis.set(xlim=(-3, 3), ylim=(-3, 3))
    name = f"fish-eye: largest deviation of {theta.size} rays from their circles, over the radius"
    return [Fact(name, max(closed), "", 2)]


def _parabolic(axis: Axes, device: Device, index: float, slope: float) -> list[Fact]:
    medium, facts = parabolic(index, slope), []
    longest = 2.0 * np.pi / slope
    for degrees, color in zip((0.0, 10.0, 30.0), style.HUES, strict=False):
        theta, small = np.radians(degrees), 1e-3 * (degrees == 0)
        until = 1.3 * longest / (index * np.cos(theta))
        rays = march(medium, [[small, 0.0, 0.0]], [[np.sin(theta), 0.0, np.cos(theta)]], step=until / 600, until=until,
                     rows=601, device=device)  # fmt: skip
        x, z = rays.path[0, :, 0], rays.path[0, :, 2]
        axis.plot(z, x, color=color, label=f"{degrees:.0f}°")
        facts.append(Fact(f"period at {degrees:.0f}°", _period(x, z, np.pi / longest * 2.0 / np.cos(theta)), "mm", 6,
                          longest * float(np.cos(theta)), "2π·cosθ/g"))  # fmt: skip
    axis.set(title="Parabolic medium", xlabel="z [mm]", ylabel="x [mm]")
    axis.legend(loc="lower left", ncols=3)
    return facts


def _period(x: np.ndarray, z: np.ndarray, guess: float) -> float:
    """Period [mm] of a sampled oscillation, by fitting a wave whose frequency is refined by Gauss and Newton."""
    frequency = guess
    for _ in range(20):
        wave = np.stack([np.cos(frequency * z), np.sin(frequency * z)], axis=1)
        (a, b), *_ = np.linalg.lstsq(wave, x, rcond=None)
        bend = z * (b * wave[:, 0] - a * wave[:, 1])
        full, *_ = np.linalg.lstsq(np.column_stack([wave, bend]), x, rcond=None)
        frequency += full[2]
    return 2.0 * np.pi / frequency


def _slopes(axis: Axes, doublings: int) -> list[Fact]:
    """In float64 on every device, because rounding would hide the slope."""
    lens, place, along, facts = fish_eye(1.0), [[0.7, 0.0]], [[0.2, 1.0]], []
    exact = march(lens, place, along, step=2.0 / 8192, until=2.0, device="numpy").place
    counts = 32 * 2 ** np.arange(doublings)
    for (scheme, order), color in zip(ORDERS.items(), style.HUES, strict=False):
        errors = [float(np.linalg.norm(
            march(lens, place, along, step=2.0 / n, until=2.0, scheme=scheme, device="numpy").place - exact))
            for n in counts]  # fmt: skip
        axis.loglog(counts, errors, "o-", color=color, ms=4, label=f"{scheme} (order {order})")
        facts.append(Fact(f"slope of {scheme}", float(-np.polyfit(np.log(counts), np.log(errors), 1)[0]), "", 3, order))
    axis.set(title="Error over the number of steps", xlabel="steps", ylabel="distance from the exact end")
    axis.set_xticks(counts, [str(n) for n in counts])
    axis.minorticks_off()
    axis.legend()
    return facts
