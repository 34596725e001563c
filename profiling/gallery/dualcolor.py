"""One color, one color with a tolerance, and two colors on the same slice."""

from __future__ import annotations

from math import ceil, sqrt
from typing import TYPE_CHECKING

import numpy as np

from profiling.color_contrast import Contrast
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.species import PAPER
from vamgpu.geometry import Beam, Turntable
from vamgpu.methods.dual import METHODS, Colors, DualPlan, superpose
from vamgpu.operators.projection import Projection
from vamgpu.optics.vat import Vat
from vamgpu.reports import style
from vamgpu.targets.designs import DIAMETER, side
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABELS = {
    "sc": "SC", "sc2": "SC2", "dc": "DC, UV recomputed", "dc kept": "DC, both add up",
    "least squares": "DC, least squares",
}  # fmt: skip
HUES = dict(zip(LABELS, style.HUES, strict=False))


def dualcolor(
    device: Device, quick: bool = False, pixels: int = 160, angles: int = 360, visible: float = 1.0, uv: float = 1.0
) -> Picture:
    """Words in a slice of Ø30 mm; ``visible`` and ``uv`` are μR of the two colors."""
    n, turn = (48, 60) if quick else (int(pixels), int(angles))
    target = words(n)
    colors = slice_colors(target, turn, device, (visible, uv))
    plans = {name: superpose(colors, target, name) for name in LABELS if name in METHODS}
    design = target.numpy()
    found = {name: Contrast.of(plan.dose(), design) for name, plan in plans.items()}
    figure, axes = style.sheet("abcde;fghij;kkkll", 7.4, height_ratios=(1.0, 1.0, 1.15))
    for (top, below), (name, plan) in zip(zip("abcde", "fghij", strict=True), plans.items(), strict=True):
        _pair(axes[top], axes[below], plan, design, LABELS[name])
    _doses(axes["k"], plans, design)
    for name, plan in plans.items():  # a single pass is a point
        number = [record.number for record in plan.history]
        mark = "o" if len(number) == 1 else "-"
        axes["l"].semilogy(number, [r.undersupply for r in plan.history], mark, color=HUES[name])
        axes["l"].semilogy(number, [r.oversupply for r in plan.history], mark, color=HUES[name], alpha=0.45)
    axes["l"].set(xlabel="pass", ylabel="RMS over D_in,max", ylim=(1e-2, 1), title="Undersupply (strong), oversupply")
    axes["l"].legend(axes["k"].get_lines()[::2], [LABELS[name] for name in plans], loc="upper right", fontsize=7.5)
    rows = tuple((LABELS[name], _row(found[name])) for name in plans)
    header = ("rule", "D in, least", "D in, spread", "D out, greatest", "window", "mean in − out", "IoU at 0.5",
              "IoU at 0.75", "undersupply", "oversupply")  # fmt: skip
    facts = (
        Fact("window of one color (SC)", found["sc"].window, "D_in,max", 3),
        Fact("window of one color with a tolerance of 75 % (SC2)", found["sc2"].window, "D_in,max", 3),
        Fact("window of two colors, the rule of the text (DC)", found["dc"].window, "D_in,max", 3),
        Fact("window of two colors, both adding up", found["dc kept"].window, "D_in,max", 3),
        Fact("window of two colors, least squares", found["least squares"].window, "D_in,max", 3),
    )
    caption = (
        "Words in one slice by five rules: one color of light (SC), one with a tolerance (SC2), and two colors (DC), "
        "whose UV light inhibits the cure. Above, effective doses divided by D_in,max; below, the voxels with at least "
        "0.75 of it: correct in black, missing in blue, excess in red. SC projects the design, SC2 corrects one "
        "sinogram with 75 % allowed around the part, DC subtracts UV dose. The rule in the paper's text recomputes the "
        "UV light in each pass. Visible light accumulates and UV light does not, so the oversupply returns. Here a "
        "contrast like the paper's requires that the UV light also accumulates; least squares over both sinograms does "
        "better. Doses are linear here: no chemistry, no "
        f"depletion. {n} × {n} voxels, {turn} angles, a diagonal of {DIAMETER:g} mm; Beer–Lambert with μR = "
        f"{visible:g} for visible and {uv:g} for UV light."
    )
    return Picture(figure, caption, facts, Table(header, ("+.3f", ".3f", "+.3f", "+.3f", ".3f", ".3f", ".3f", ".4f",
                   ".4f"), rows), (PAPER,))  # fmt: skip


def slice_colors(target: Target, angles: int, device: Device, extinctions: tuple[float, float]) -> Colors:
    """Both colors on a square slice as wide diagonally as the resin, in a matched vat, one voxel per pixel."""
    n, pitch = target.grid.shape[0], target.grid.pitch
    radius = 0.5 * n * pitch * sqrt(2.0)
    beam = Beam((ceil(n * sqrt(2.0)), 1), pitch)
    vats = (Vat(2.1 * radius, radius=radius, absorption=mu / radius) for mu in extinctions)
    visible, uv = (Projection(target.grid, beam, Turntable(angles), vat, device) for vat in vats)
    return Colors(visible, uv, whole=True)


def words(n: int) -> Target:
    """Letters with counters, drawn as outlines, as a single slice."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    fine = 3
    place = (np.arange(n * fine) + 0.5) / (n * fine) - 0.5
    plane = np.zeros((n * fine, n * fine), bool)
    x, y = np.meshgrid(place, place, indexing="ij")
    for text, height in (("dose", 0.17), ("add", -0.08), ("a b e g", -0.33)):
        path = TextPath((0, 0), text, size=0.24, prop=FontProperties(family="DejaVu Sans", weight="bold"))
        box = path.get_extents()
        path = path.transformed(_shift(-0.5 * (box.x0 + box.x1), height))
        # outline and counter have opposite winding: combine outlines by parity
        for polygon in path.to_polygons():
            plane ^= _inside(np.asarray(polygon), x, y)
    fraction = plane.reshape(n, fine, n, fine).mean(axis=(1, 3))
    return Target.from_array(fraction[:, :, None], side() / n, name="words")


def _shift(dx: float, dy: float):  # noqa: ANN202 - a transform of a heavy module
    from matplotlib.transforms import Affine2D

    return Affine2D().scale(0.95).translate(dx, dy)


def _inside(polygon: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    from matplotlib.path import Path

    return Path(polygon).contains_points(np.stack([x.ravel(), y.ravel()], 1)).reshape(x.shape)


def verdict(got: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Colors [x, y, 3] of a print against its design: right, missing, too much."""
    picture = np.ones((*got.shape, 3))
    picture[got & wanted] = (0.13, 0.16, 0.2)
    picture[~got & wanted] = (0.35, 0.6, 0.9)
    picture[got & ~wanted] = (0.9, 0.35, 0.35)
    return picture


def _pair(dose: Axes, print_: Axes, plan: DualPlan, design: np.ndarray, title: str) -> None:
    values, wanted = plan.dose().numpy()[:, :, 0], design[:, :, 0] >= 0.5
    values = values / values[wanted].max()
    style.shown(dose, values, title, vmin=-0.2, vmax=1.0)
    print_.imshow(verdict(values >= 0.75, wanted).transpose(1, 0, 2), origin="lower", interpolation="nearest")
    print_.grid(False)
    style.bare(print_)


def _doses(axis: Axes, plans: dict[str, DualPlan], design: np.ndarray) -> None:
    wanted = design >= 0.5
    edges = np.linspace(-0.3, 1.05, 100)
    for name, plan in plans.items():
        dose = plan.dose().numpy()
        dose = dose / dose[wanted].max()
        for part, dash in ((wanted, "-"), (~wanted, ":")):
            counts = np.histogram(dose[part], edges)[0] / part.sum()
            axis.plot(0.5 * (edges[1:] + edges[:-1]), counts, dash, color=HUES[name], lw=1.4)
    axis.set(xlabel="dose over D_in,max", ylabel="share of voxels", yscale="log", ylim=(1e-4, 1),
             title="Doses in the part (lines) and out of it (dots)")  # fmt: skip


def _row(c: Contrast) -> tuple[float, ...]:
    doses = (c.in_least, c.in_spread, c.out_most, c.window, c.mean)
    return (*doses, c.half, c.three_quarters, c.undersupply, c.oversupply)
