"""A grayscale phantom reproduced exactly by light of both signs, and the requirements for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.exact_reconstruction import ExactPlan, reconstruct
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.species import PAPER
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTHS = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005)
FINE = 4
"""Supersampling of the buildup between the points."""


def exact(
    device: Device, quick: bool = False, pixels: int = 100, angles: int = 360, subtraction: float = 1.0
) -> Picture:
    """The phantom at μR = 1; ``subtraction`` is μR of the light whose dose is subtracted."""
    del device  # one point after another: not suitable for a device
    n, turn = (24, 90) if quick else (int(pixels), int(angles))
    design = _phantom(n)
    plans = {w: reconstruct(design, angles=turn, width=w, subtraction=subtraction) for w in WIDTHS}
    rows = [(f"{w:g}", (p.error(design), p.error(design, FINE), float(np.abs(p.light).max()), float(p.blocked.sum())))
            for w, p in plans.items()]  # fmt: skip
    best = plans[0.02]
    single = reconstruct(design, angles=turn, width=0.02, subtraction=subtraction, dtype=np.float32)
    figure, axes = style.sheet("abcd;eeff", 5.6, height_ratios=(1.0, 1.1))
    _pictures(axes, design, best)
    _curves(axes["e"], axes["f"], rows)
    facts = (
        Fact("RMS at the points, bins of 0.02 px, float64", float(rows[5][1][0]), "", 2, 1e-12, "specified", "≤"),
        Fact("RMS at the points, bins of 0.02 px, float32", single.error(design), "", 2, 1e-6, "specified", "≤"),
        Fact(f"RMS on a {FINE}× supersampled buildup, bins of 0.02 px", rows[5][1][1], "", 3),
        Fact("greatest |I′|, bins of 0.02 px", rows[5][1][2], "per rad", 3),
        Fact("points without a free angle, bins of 0.02 px", rows[5][1][3], "", 3),
        Fact("share of the light that subtracts", float(best.negative.sum() / np.abs(best.light).sum()), "", 3),
    )
    table = Table(("bin [px]", "RMS at points", f"RMS, {FINE}× finer", "greatest |I′|", "points without a free angle"),
                  (".2g", ".3g", ".3g", ".0f"), tuple(rows))  # fmt: skip
    caption = (
        f"{n} × {n} points, {turn} angles, μR = 1 for light that adds and {subtraction:g} for light that subtracts. "
        "Points are processed one after another. Each is corrected only at angles at which no earlier point shares its "
        "bin; a correct dose therefore never changes again. The buildup is absolute, never rescaled. It is exact at "
        "the points if every point has a free angle, which needs narrow bins; otherwise the light grows without limit. "
        "Between the points, where there is also resin, the dose is not exact; the finer buildup shows the error."
    )
    return Picture(figure, caption, facts, table, (PAPER,))


def _phantom(n: int) -> np.ndarray:
    from skimage.data import shepp_logan_phantom
    from skimage.transform import resize

    image = np.asarray(resize(shepp_logan_phantom(), (n, n), anti_aliasing=True))
    return np.clip(image[::-1].T, 0.0, 1.0)


def _pictures(axes: dict[str, Axes], design: np.ndarray, plan: ExactPlan) -> None:
    style.shown(axes["a"], design, "Design", cmap="gray", vmin=0, vmax=1)
    style.shown(axes["b"], plan.buildup(), "Buildup at the points", cmap="gray", vmin=0, vmax=1)
    for name, light, title in (("c", plan.positive, "Light that adds"), ("d", plan.negative, "Light that subtracts")):
        coarse = _binned(light, 200)
        top = float(np.percentile(coarse, 99.5)) or 1.0
        style.shown(axes[name], coarse, title, cmap=style.LIGHT, vmin=0, vmax=top, aspect="auto")
        axes[name].set(xlabel="angle", ylabel="r")


def _binned(light: np.ndarray, columns: int) -> np.ndarray:
    """Narrow bins averaged to as many columns as a picture shows."""
    each = -(-light.shape[1] // columns)
    padded = np.pad(light, ((0, 0), (0, each * columns - light.shape[1])))
    return padded.reshape(len(light), columns, each).mean(axis=2)


def _curves(errors: Axes, amounts: Axes, rows: list[tuple[str, tuple[float, ...]]]) -> None:
    width = [float(name) for name, _ in rows]
    values = np.array([row for _, row in rows])
    errors.loglog(width, values[:, 0], "o-", color=style.BLUE, label="at the points")
    errors.loglog(width, values[:, 1], "s-", color=style.ORANGE, label=f"{FINE} × {FINE} places a point")
    errors.set(xlabel="width of a bin [px]", ylabel="RMS of buildup − design", title="Error")
    amounts.loglog(width, values[:, 2], "o-", color=style.RED, label="greatest |I′| [1/rad]")
    amounts.loglog(width, np.maximum(values[:, 3], 0.5), "s-", color=style.GREEN,
                   label="points without a free angle (0 drawn at ½)")  # fmt: skip
    amounts.set(xlabel="width of a bin [px]", title="Light, and points without a free angle")
    for axis in (errors, amounts):
        axis.invert_xaxis()
        axis.legend()
