"""The print of the frames in the vial: dose, histogram, and the printed part compared with the target."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture
from profiling.gallery.scale_bar import scale_bar
from vamgpu.backend.device import Device
from vamgpu.methods import optimize
from vamgpu.metrics.parts import IN, OUT
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import pack
from vamgpu.printing.pictures import EXCESS, HIT, MISSING, OUTSIDE, verdicts
from vamgpu.printing.proof import Proof
from vamgpu.printing.simulate import simulate
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHTS = (0.12, 0.45, 0.7)
NEEDED = 7.38
"""Radius [mm] that a 3DBenchy of 11.5 mm needs, for its smallest enclosing circle."""


def proof(
    device: Device,
    quick: bool = False,
    pitch: float = 0.12,
    angles: int = 360,
    iterations: int = 40,
    irradiance: float = 0.05,
    critical_dose: float = 0.04,
    black: float = 0.002,
) -> Picture:
    """The boat in the vial in air: irradiance of a full-on pixel in mW/mm², critical dose in mJ/mm³."""
    target = scene.boat(device, 0.6 if quick else pitch)
    A = scene.in_vial(target, 24 if quick else int(angles), device)
    plan = optimize(A, target, iterations=4 if quick else int(iterations))
    shone = pack(plan, gray=GrayCurve.gamma(2.2, black))
    proven = simulate(A, shone, target, irradiance=irradiance, critical_dose=critical_dose)
    figure, axes = style.sheet("abcd;efgh;iiii", 7.4, height_ratios=[1, 1, 0.95])
    _slices(axes, proven)
    _histogram(axes["i"], proven)
    s = proven.scores
    facts = (
        Fact("strict process window", s.window, "", 3),
        Fact("strict process window of the plan, before packing", plan.window, "", 3),
        Fact("IoU at the best threshold", s.iou, "", 5),
        Fact("VER, voxels on the wrong side", s.error_rate, "", 2),
        Fact("IPDR, range of the dose in the part over the peak", s.dose_range, "", 3),
        Fact("mean brightness, mean pixel over full-on", 100 * proven.mean_brightness, "%", 3),
        Fact("light efficiency, share of the light sent that the part absorbs", 100 * proven.light_efficiency, "%", 3),
        Fact("predicted exposure", float(proven.seconds or 0.0), "s", 3),
        Fact("radius of the boat", target.radius, "mm", 4, NEEDED, "that of the 3DBenchy at this height", "≤"),
    )
    caption = (
        "The boat, 11.5 mm high, printed in a vial of 24.8 mm that turns in air, with refraction, loss at both faces "
        "and absorption. The dose is computed only from the packed bytes and the projector's curve, with one scale for "
        "all sections. Everything above the threshold is printed. The sections are at three heights and upright "
        "through the axis."
    )
    return Picture(figure, caption, facts, papers=plan.papers)


def _slices(axes: dict[str, Axes], proven: Proof) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    grid, peak = proven.operator.grid, proven.scores.peak
    cylinder = grid.cylinder()
    dose = np.where(cylinder[:, :, None], proven.dose.numpy() / peak, np.nan)
    verdict = verdicts(proven.target.numpy(), proven.printed(), cylinder)
    colors = {0: "#f2f4f7", HIT: "#9fb4cc", MISSING: style.RED, EXCESS: style.ORANGE, OUTSIDE: "white"}
    look: dict[str, Any] = {"cmap": ListedColormap(list(colors.values())), "vmin": -0.5, "vmax": 4.5}
    z = grid.axes()[2]
    for k, share in enumerate(HEIGHTS):
        at = z[min(int(share * len(z)), len(z) - 1)]
        drawn = style.shown(axes["abc"[k]], scene.level(dose, share), f"Dose, z = {_signed(at)} mm", vmin=0, vmax=1)
        style.shown(axes["efg"[k]], scene.level(verdict, share), f"Print, z = {_signed(at)} mm", **look)
    style.shown(axes["d"], scene.upright(dose), "Dose, y = 0", vmin=0, vmax=1)
    style.shown(axes["h"], scene.upright(verdict), "Print, y = 0", **look)
    scale_bar(axes["a"], 2.0 / grid.pitch, "2 mm", below=True)
    style.bar(drawn, [axes["d"], axes["h"]], "dose over its greatest", shrink=0.6)
    names = {HIT: "part, printed", MISSING: "missing", EXCESS: "excess"}
    patches = [Patch(color=colors[v], label=f"{n}: {int((verdict == v).sum()):,} voxels") for v, n in names.items()]
    axes["e"].figure.legend(handles=patches, ncols=3, loc="outside upper center")  # type: ignore[union-attr]


def _signed(value: float, places: int = 1) -> str:
    return f"{value:+.{places}f}".replace("-", "−")


def _histogram(axis: Axes, proven: Proof) -> None:
    found, s = proven.histogram(200), proven.scores
    edges = found.edges / s.peak
    for which, color, name in ((OUT, style.QUIET, "outside the part"), (IN, style.BLUE, "in the part")):
        counts = np.maximum(found.counts[0, which], 0.5)
        axis.stairs(counts, edges, baseline=0.5, fill=True, color=color, alpha=0.3)
        axis.stairs(counts, edges, baseline=0.5, color=color, lw=1.3, label=name)
    low, high = sorted((s.greatest_out / s.peak, s.least_in / s.peak))
    good = s.window > 0
    axis.axvspan(low, high, color=style.GREEN if good else style.RED, alpha=0.15, lw=0,
                 label=f"{'process window' if good else 'overlap'} {_signed(s.window, 3)}")  # fmt: skip
    axis.axvline(s.threshold / s.peak, color=style.INK, lw=1.2, ls=(0, (4, 3)), label="threshold")
    axis.set(title="Voxels over dose", yscale="log", xlim=(0, 1), ylim=(0.7, None), xlabel="dose over its greatest",
             ylabel="voxels")  # fmt: skip
    axis.legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
