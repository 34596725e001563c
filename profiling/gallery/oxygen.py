"""A slice in resin that an older print left short of oxygen: patterns that ignore it, and patterns that follow it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery.dualcolor import verdict
from profiling.gallery.picture import Fact, Picture, Table
from profiling.oxygen import SOLID, scene, transported, wheel
from vamgpu.backend.device import Device
from vamgpu.chemistry.oxygen import Oxygen, OxygenModel
from vamgpu.methods import LBFGS, optimize
from vamgpu.methods.papers import LIMITED_MEMORY, THRESHOLDS
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLOOR = 0.005
"""Share of light that the monomer takes beside saturated resin, in the model."""
LABELS = ("oxygen ignored", "oxygen followed")


def oxygen(
    device: Device, quick: bool = False, pixels: int = 48, angles: int = 60, iterations: int = 80,
    diffusivity: float = 1e-3, taken: float = 0.4,
) -> Picture:  # fmt: skip
    """A wheel in five turns of 9 s.

    diffusivity: of oxygen [mm²/s].  taken: greatest share of the oxygen that an older print used up.
    """
    size, count = (24, 4) if quick else (int(pixels), int(iterations))
    A = scene(size, 2, device, 24 if quick else int(angles))
    part, near = wheel(A, size / 64.0), np.broadcast_to(A.grid.cylinder()[:, :, None], A.domain.shape)
    x, y, _ = np.meshgrid(*A.grid.axes(), indexing="ij")
    used = taken * np.exp(-((x - 1.2 * size / 64.0) ** 2 + y**2) / (1.5 * size / 64.0) ** 2)
    model = OxygenModel(A, Oxygen(diffusivity, 5, 9.0, used, floor=FLOOR))
    plain = optimize(A, part, LBFGS(0.85, 1.25, 1.5), count, progress=False)
    plan = optimize(model, part, iterations=count, start=plain, progress=False)
    lights = [one.sinogram.numpy() for one in (plain, plan)]
    doses = [transported(model, light) for light in lights]
    figure = _drawn(model, part, used, doses, lights[1])
    rows = tuple((name, _row(dose, part, near)) for name, dose in zip(LABELS, doses, strict=True))
    wrong = [values[0] for _, values in rows]
    gap = np.abs(np.asarray(model.T(lights[1])) - doses[1])[near].max() / doses[1][near].max()
    facts = (
        Fact("voxels on the wrong side of the threshold, oxygen ignored", wrong[0], f"of {near.sum():,}", 4),
        Fact("voxels on the wrong side of the threshold, oxygen followed", wrong[1], f"of {near.sum():,}", 4),
        Fact(
            "greatest difference between the model, with a floor of 0.005, and the judge, without one",
            100 * gap,
            "% of the greatest dose",
            2,
        ),
    )
    caption = (
        f"{size} × {size} voxels of 0.1 mm, {A.motion.angles} angles, 5 turns of 9 s; D = {diffusivity:g} mm²/s. An "
        f"older print used up as much as {100 * taken:.0f} % of the oxygen on the right. Doses are effective: 1 is the "
        f"end of the induction, and resin is solid from {SOLID:g}. Patterns of the plain dose overcure the right side "
        "and close holes and the slit; those of `OxygenModel` give less light to resin with less oxygen. `Transport` "
        "judges both, angle by angle. Middle row: correct in black, missing in blue, excess in red. Below: the oxygen "
        "that the second patterns leave, when they make resin solid, and the doses of voxels in the part (lines) and "
        "outside (dots)."
    )
    header = ("patterns", "wrong voxels", "D in, least", "D out, most", "window")
    return Picture(figure, caption, facts, Table(header, (".0f", ".3f", ".3f", "+.3f"), rows),
                   (LIMITED_MEMORY, THRESHOLDS))  # fmt: skip


def _row(dose: np.ndarray, part: np.ndarray, near: np.ndarray) -> tuple[float, ...]:
    inside, outside = dose[near & (part > 0.5)], dose[near & (part < 0.5)]
    wrong = float(((dose >= SOLID) != (part > 0.5))[near].sum())
    return (wrong, float(inside.min()), float(outside.max()),
            float((inside.min() - outside.max()) / dose[near].max()))  # fmt: skip


def _drawn(model: OxygenModel, part: np.ndarray, used: np.ndarray, doses: list[np.ndarray], light: Any) -> Figure:
    figure, axes = style.sheet("abc;def;ghi", 9.4)
    left, times = 1.0 - model.state(light).used.numpy(), model.gel_times(light, SOLID)
    first = style.shown(axes["a"], 1.0 - used[:, :, 0], "oxygen before the print", cmap="viridis", vmin=0.0, vmax=1.0)
    style.shown(axes["d"], part[:, :, 0], "part", cmap=style.SOLID)
    for (above, below), name, dose in zip(("be", "cf"), LABELS, doses, strict=True):
        shade = style.shown(axes[above], dose[:, :, 0], name, vmin=0.0, vmax=1.6)
        axes[below].imshow(verdict((dose >= SOLID)[:, :, 0], part[:, :, 0] >= 0.5).transpose(1, 0, 2), origin="lower",
                           interpolation="nearest")  # fmt: skip
        style.bare(axes[below])
        axes[below].grid(False)
    style.shown(axes["g"], left[:, :, 0], "oxygen after the print", cmap="viridis", vmin=0.0, vmax=1.0)
    gelled = np.where(np.isinf(times), np.nan, times)[:, :, 0]
    last = style.shown(axes["h"], gelled, "solid after [s]", cmap="cividis", vmin=0.0, vmax=model.oxygen.seconds)
    for drawn, name in ((first, "a"), (shade, "c"), (last, "h")):
        figure.colorbar(drawn, ax=axes[name], shrink=0.8)
    for name, dose in zip(LABELS, doses, strict=True):
        for inside, line in ((True, "-"), (False, ":")):
            share, edges = np.histogram(dose[(part > 0.5) == inside], np.linspace(0.0, 1.8, 73), density=True)
            color = style.ORANGE if name == LABELS[0] else style.BLUE
            axes["i"].step(edges[:-1], share, line, where="post", color=color, label=name if inside else None)
    axes["i"].axvline(SOLID, color=style.INK, lw=1)
    axes["i"].set(title="Effective dose, in the part and outside", yscale="log")
    axes["i"].legend(loc="lower left", bbox_to_anchor=(0.0, -0.42))
    return figure
