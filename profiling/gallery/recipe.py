"""The recipe of automatic exposure, one picture for each step."""

from __future__ import annotations

from typing import Any

import numpy as np

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture, Table
from profiling.gallery.scale_bar import scale_bar
from vamgpu.backend.device import Device
from vamgpu.methods import Recipe
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE, RAMP
from vamgpu.methods.ramp import ramp
from vamgpu.methods.state import OptimizerState
from vamgpu.reports import style
from vamgpu.targets.target import Target

HEIGHT = 0.22
"""Share of the boat's height at which the sections are taken."""


def recipe(
    device: Device,
    quick: bool = False,
    pitch: float = 0.12,
    angles: int = 360,
    background: float = 0.6,
    passes: int = 6,
) -> Picture:
    """The boat in straight light; the paper projects at every degree, over a background of 60 %, and corrects twice."""
    target = scene.boat(device, 0.6 if quick else pitch)
    A = scene.straight(target, 24 if quick else int(angles), device)
    state = OptimizerState(A, target.on(device), {})
    model, projected, filtered = _first_light(state, background)
    steps, windows, kept = Recipe(background).steps(state), [], {}
    for k in range(1, (2 if quick else int(passes)) + 1):
        windows.append(next(steps)[1])
        if k <= 2:
            light = state.buffer("light").numpy()
            dose = A.T(state.buffer("light")).numpy()
            kept[k] = (light, dose, state.buffer("model").numpy())
    figure = _drawn(target, (model, projected, filtered), kept)
    inside = A.grid.cylinder()[:, :, None] & (target.numpy() <= 0)
    ratios = [float(dose[inside].mean() / dose[target.numpy() >= 1].mean()) for _, dose, _ in kept.values()]
    negative = float(-filtered[filtered < 0].sum() / np.abs(filtered).sum())
    facts = (
        *(Fact(f"mean dose around the part divided by that in it, pass {k}", 100 * ratio, "%", 3, 100 * background,
               "background of the paper" if background == 0.6 else "asked for") for k, ratio in enumerate(ratios, 1)),
        Fact("light of either sign that clipping removes", 100 * negative, "%", 3),
        Fact("pixels that stay dark", 100 * float((kept[1][0] <= 0).mean()), "%", 3),
    )  # fmt: skip
    rows = tuple((str(k), (window,)) for k, window in enumerate(windows, 1))
    table = Table(("pass", "strict process window"), ("+.4f",), rows)
    caption = (
        f"The target has a background of {100 * background:g} % of its dose, because light cannot be negative. Its "
        "projection is filtered by a ramp and clipped at zero. Where the dose then differs from the target, the model "
        "is corrected by the ratio, and the next pass starts from there. All sections and sinograms are at one height, "
        "just above the deck. The table gives the strict window after each pass; the correction does not optimize it."
    )
    return Picture(figure, caption, facts, table, (AUTOMATIC_EXPOSURE, RAMP))


def _first_light(state: OptimizerState, background: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Model, projection and filtered projection of the first pass."""
    model, projected, filtered = state.volume(), state.sinogram(), state.sinogram()
    state.fill_background(background, model)
    state.project(model, projected)
    state.filter(projected, ramp(state.operator), filtered)
    return model.numpy(), projected.numpy(), filtered.numpy()


def _drawn(target: Target, first: tuple[np.ndarray, ...], kept: dict[int, tuple[np.ndarray, ...]]) -> Any:
    figure, axes = style.sheet("abcd;efgh", 5.6)
    pitch, (model, projected, filtered) = target.grid.pitch, first
    (light, dose, after), (_, second, _) = kept[1], kept[2]
    volumes = {"cmap": style.DOSE, "vmin": 0.0, "vmax": 1.2}
    lights = {"aspect": "auto", "cmap": style.LIGHT, "vmin": 0.0}
    most = float(np.quantile(light, 0.9995))
    swing = float(np.quantile(np.abs(filtered), 0.9995))
    drawn = style.shown(axes["a"], scene.level(target.numpy(), HEIGHT), "1  Target", **volumes)
    style.shown(axes["b"], scene.level(model, HEIGHT), "2  On a background", **volumes)
    style.shown(axes["c"], scene.level(projected, HEIGHT).T, "3  Projected", **lights)
    style.shown(axes["d"], scene.level(filtered, HEIGHT).T, "4  Filtered", aspect="auto", cmap=style.GAP, vmin=-swing,
                vmax=swing)  # fmt: skip
    style.shown(axes["e"], scene.level(light, HEIGHT).T, "5  Clipped", **lights, vmax=most)
    style.shown(axes["f"], scene.level(dose, HEIGHT), "6  Dose", **volumes)
    style.shown(axes["g"], scene.level(after, HEIGHT), "7  Corrected model", **volumes)
    style.shown(axes["h"], scene.level(second, HEIGHT), "8  Second dose", **volumes)
    for letter in "cde":
        axes[letter].set(xlabel="r →", ylabel="angle θ →", box_aspect=1)
    scale_bar(axes["a"], 2.0 / pitch, "2 mm")
    style.bar(drawn, [axes["d"], axes["h"]], "dose and model, 1 is the required dose in the part", shrink=0.7)
    return figure
