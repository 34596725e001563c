"""The paper's lattice block in one color and in two, through the kinetics."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.dualcolor import verdict
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.kinetics import advance
from vamgpu.chemistry.species import LightCycle, Rates, SpeciesState
from vamgpu.geometry import Beam, Turntable
from vamgpu.methods import bound, optimize
from vamgpu.methods.dual import Colors, DualPlan, superpose
from vamgpu.methods.dual.colors import Pair
from vamgpu.methods.joint.rule import ThroughKinetics
from vamgpu.methods.pdhg import PDHG
from vamgpu.operators.pose_runs import PoseRuns
from vamgpu.operators.projection import Projection
from vamgpu.optics.vat import Vat
from vamgpu.reports import style
from vamgpu.targets.designs import Block
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLOCK = Block((5, 5, 6), 0.45, 0.9)
RATES = Rates(k_a=1.0 / 30.0, k_b=0.2138 / 30.0, k_c=1.0 / 30.0, k_2=0.43, supply=5.0)
DEPTH, PERIOD = 0.5, 10.0
"""μR of both colors; time of a turn [s]."""
EXPOSURES = (1.0, 1.05, 1.3)
"""Exposures at which the exact equations judge, relative to that of the plan."""
HUES = (style.ORANGE, style.BLUE)
LABELS = ("one color", "two colors, solver's steps", "two colors, finer steps")


def block(
    device: Device, quick: bool = False, pixels: int = 32, angles: int = 40, iterations: int = 420, turns: int = 3
) -> Picture:
    """The block of 5 × 5 × 6 compartments; ``iterations`` of the kinetics."""
    n, poses, count, even = (24, 16, 20, 80) if quick else (int(pixels), int(angles), int(iterations), 1500)
    target = BLOCK.target(float(np.hypot(*BLOCK.size[:2])) / (n - 5))
    visible, uv = colors(target, poses, device)
    alone = optimize(visible, target, PDHG(), evaluations=0.5 * even, progress=False)
    most = bound(visible, target, even, progress=False).value
    rule = ThroughKinetics(RATES.k_a, RATES.k_b, RATES.k_c, RATES.k_2, RATES.supply, int(turns), PERIOD,
                           iterations=count)  # fmt: skip
    plan = superpose(Colors(visible, uv), target, rule)
    near = np.broadcast_to(target.grid.cylinder()[:, :, None], target.grid.shape)
    part = target.numpy() >= 0.5
    finer = rule.dose(plan.colors, Pair(plan.visible, plan.uv), finer=True)  # type: ignore[arg-type]
    doses = [np.maximum(dose.numpy(), 0.0) for dose in (visible.T(alone.sinogram), plan.dose(), finer)]
    rows = tuple((name, _row(dose, part[near], near)) for name, dose in zip(LABELS, doses, strict=True))
    windows = [values[-1] for _, values in rows]
    cured = [_exactly_cured(plan, near, int(turns), share) for share in EXPOSURES]
    facts = (
        Fact("window of one color", windows[0], "of the greatest dose", 3),
        Fact("upper bound of the window of one color", most, "of the greatest dose", 3),
        Fact("window of two colors, in the solver's steps", windows[1], "of the greatest dose", 3),
        Fact("window of two colors, in finer steps", windows[2], "of the greatest dose", 3),
        Fact("window of two colors, in finer steps, over that of one", windows[2] / windows[0], "", 3, 3.0, bound="≥"),
        *(Fact(f"{what} by eqs 5-7, {share:g} times the exposure", 100.0 * found[where].mean(), "%", 4)
          for share, found in zip(EXPOSURES, cured, strict=True)
          for what, where in (("part cured", part[near]), ("outside cured", ~part[near]))),
    )  # fmt: skip
    header = ("patterns", "D in, least", "D out, most", "D in, most", "window")
    return Picture(_drawn(target, doses), _caption(target, poses, int(turns), plan), facts,
                   Table(header, (".3f", ".3f", ".3f", "+.3f"), rows), plan.papers)  # fmt: skip


def colors(target: Target, poses: int, device: Device) -> tuple[Projection, Projection]:
    """Operators of both colors in resin that just holds the grid's cylinder, one voxel per pixel."""
    grid, radius = target.grid, 1.001 * target.grid.inscribed_radius
    vat = Vat(2.1 * radius, radius=radius, absorption=DEPTH / radius)
    visible, uv = (Projection(grid, Beam((grid.shape[0], grid.shape[2]), grid.pitch), Turntable(poses), vat, device)
                   for _ in range(2))  # fmt: skip
    return visible, uv


def _row(dose: np.ndarray, part: np.ndarray, near: np.ndarray) -> tuple[float, ...]:
    inside, outside = dose[near][part], dose[near][~part]
    top = dose[near].max()
    return tuple(float(one) for one in (inside.min() / top, outside.max() / top, inside.max() / top,
                                        (inside.min() - outside.max()) / top))  # fmt: skip


def _exactly_cured(plan: DualPlan, near: np.ndarray, turns: int, share: float) -> np.ndarray:
    """Where eqs 5-7, without a floor and with the light of every angle at its time, end the induction."""
    angles, lights = plan.visible.shape[0], (plan.visible, plan.uv)
    seen = np.zeros((2, int(near.sum()), angles))
    for color, (operator, light) in enumerate(zip((plan.colors.visible, plan.colors.uv), lights, strict=True)):
        A, dose = operator, operator.device.empty(operator.domain.shape)
        assert isinstance(A, Projection) and A.vessel is not None and light is not None
        runs, fluence = PoseRuns(A, angles), A.beam.pixel_area / A.grid.voxel_volume / A.vessel.absorption
        for angle in range(angles):
            runs.expose(angle, light, dose)
            seen[color, :, angle] = share * fluence * angles / PERIOD * dose.numpy()[near]
    start = SpeciesState(*(np.full(seen.shape[1], value) for value in (1.0, 0.0, RATES.supply)))
    light = LightCycle(seen[0], seen[1], np.full(angles, PERIOD / angles))
    return advance(RATES, start, light, intervals=turns * angles, device=plan.visible.device).depleted[0]


def _caption(target: Target, poses: int, turns: int, plan: DualPlan) -> str:
    size = " × ".join(map(str, target.grid.shape))
    return (
        f"{size} voxels, {poses} angles, {turns} turns of {PERIOD:g} s, μR = {DEPTH:g} in both colors; "
        f"{len(plan.history)} evaluations of the kinetics. Struts of 0.45 mm, {BLOCK.strut / target.grid.pitch:.1f} "
        "voxels, lie between compartments of 0.9 mm. Voxels filled to half are the part, so that some struts have "
        "gaps. Doses are relative to the greatest: a slice across the posts, a slice along them, and the voxels from "
        "the middle of the window on, correct in black, missing in blue, excess in red. The bound holds for any "
        "patterns of one color. Patterns of two colors are found with the kinetics of oxygen and lophyl radicals; "
        "their dose is the greatest effective dose of all times. Eqs 5-7 of the paper then judge these patterns "
        "without the model's floor, angle by angle."
    )


def _drawn(target: Target, doses: list[np.ndarray]) -> Figure:
    figure, axes = style.sheet("abc;def;ghi", 9.4)
    part, near, (nx, _, nz) = target.numpy(), target.grid.cylinder(), target.grid.shape
    at, along = nz // 2 - 1, nx // 2 - 1
    style.shown(axes["a"], part[:, :, at], "part, across the posts", cmap=style.SOLID)
    style.shown(axes["b"], part[:, along], "part, along the posts", cmap=style.SOLID)
    for names, name, dose, hue in zip(
        ("def", "ghi"), ("one color", "two colors"), doses[::2], (style.ORANGE, style.BLUE), strict=True
    ):
        dose, solid = dose / dose[near].max(), part >= 0.5
        style.shown(axes[names[0]], dose[:, :, at], f"{name}, across", vmin=0.0, vmax=1.0)
        shade = style.shown(axes[names[1]], dose[:, along], f"{name}, along", vmin=0.0, vmax=1.0)
        style.bar(shade, axes[names[1]], "dose")
        middle = 0.5 * (dose[near][solid[near]].min() + dose[near][~solid[near]].max())
        shown = verdict(dose[:, :, at] >= middle, solid[:, :, at])
        axes[names[2]].imshow(np.where(near[:, :, None], shown, 1.0).transpose(1, 0, 2), origin="lower",
                              interpolation="nearest")  # fmt: skip
        axes[names[2]].set_title(f"{name}, the print")
        axes[names[2]].grid(False)
        style.bare(axes[names[2]])
        for inside, line in ((True, "-"), (False, ":")):
            share, edges = np.histogram(dose[near][solid[near] == inside], np.linspace(0.0, 1.0, 61), density=True)
            axes["c"].step(edges[:-1], share, line, where="post", color=hue, label=name if inside else None)
    axes["c"].set(title="Dose, in the part and outside", yscale="log")
    axes["c"].legend()
    return figure
