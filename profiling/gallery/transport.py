"""Oxygen, lophyl radicals and o-Cl-HABI in a vial that turns under two colors of light."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.chemistry.concentrations import Concentrations
from vamgpu.chemistry.exposure import ColorExposure, ColorExtinction
from vamgpu.chemistry.printrun import PrintRun
from vamgpu.chemistry.species import PAPER
from vamgpu.chemistry.transport import Box, Reaction, Transport
from vamgpu.geometry import centers
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DIFFUSIVITIES = (3.27e-7, 6.89e-8, 6.89e-8)
"""Oxygen and lophyl, Wilke-Chang [mm²/s]; o-Cl-HABI as lophyl."""
PITCH = (0.045, 0.045, 0.067)
PANELS = {"a": "A, oxygen [mol/m³]", "b": "B, lophyl [mol/m³]", "c": "C, o-Cl-HABI [mol/m³]",
          "optical_time": "turned visible at [s]"}  # fmt: skip


def transport(
    device: Device, quick: bool = False, angles: int = 180, turns: int = 3, turn_s: float = 36.0,
    extinction: float = 0.15, cross: float = 0.05,
) -> Picture:  # fmt: skip
    """Reactive transport of three species through a print in two colors."""
    n, angles = (48, 36) if quick else (128, angles)
    box = Box((n, n, 4 if quick else 16), PITCH, radius=PITCH[0] * (0.5 * n - 1))
    reaction = Reaction(0.055, 0.035, 0.03, 0.02, initial=2.0, cross=cross, optical=2.0, mechanical=6.0)
    resin = Transport(box, DIFFUSIVITIES, reaction, device=device)
    job = PrintRun(resin, _exposure(box, angles, extinction, device), turn_s, turns)
    state = resin.start(1.0, 0.0, 2.0)
    places = {"in the part": (n // 2, n // 2 + round(0.1 * n)), "beside it": (n // 2, n // 2 + round(0.31 * n)),
              "at the rim": (n // 2, n - 4)}  # fmt: skip
    seen: dict[str, list[list[float]]] = {name: [] for name in places}
    job.run(state, progress=lambda _, now: _look(now, places, seen))
    figure, axes = style.sheet("abc;def", 7.4)
    middle = box.shape[2] // 2
    fields = {name: values[:, :, middle] for name, values in state.numpy().items()}
    outside = ~box.open()
    for letter, (name, title) in zip("abcd", PANELS.items(), strict=True):
        plane = np.where(outside | (fields[name] < 0), np.nan, fields[name])
        image = style.shown(axes[letter], plane, title, PITCH[0], cmap="viridis")
        figure.colorbar(image, ax=axes[letter], shrink=0.8)
    _curves(axes["e"], job, seen, 0, "A [mol/m³]")
    _curves(axes["f"], job, seen, 2, "light free of inhibitors [mJ/mm²]")
    rim = _ripple(np.array(seen["at the rim"])[:, 1], angles)
    facts = (
        Fact("share of substance that 100 steps of diffusion lose", _mass(resin), "", 2, 1e-5, "specification", "≤"),
        Fact("light of an angle, largest difference from Beer–Lambert", _beer(job), "", 2, 0.01, "specification", "≤"),
        Fact("ripple of [B] at the rim within a turn, over its mean", 100 * rim, "%", 3),
        Fact("light in the part after its inhibitors are used up", seen["in the part"][-1][2], "mJ/mm²", 3),
        Fact("the same beside the part", seen["beside it"][-1][2], "mJ/mm²", 3),
        Fact("diffusion length of oxygen in the whole print", 1e3 * (6 * 3.27e-7 * turn_s * turns) ** 0.5, "µm", 3),
    )
    caption = (
        "Visible light prints a cylinder while ultraviolet light converts C into inhibitor around it. The C that is "
        "left at each angle attenuates the light of its frame. At the rim, which passes through bright and dark, "
        "concentrations therefore rise and fall every turn. Light makes polymer only where A and B are used up; where "
        "C is used up, ultraviolet light itself starts to cure. At these diffusivities and voxel sizes diffusion is "
        "hardly visible. Rates are chosen to show the course of a print; the paper's own are only in its scripts."
    )
    return Picture(figure, caption, facts, None, (PAPER,))


def _exposure(box: Box, angles: int, extinction: float, device: Device) -> ColorExposure:
    """Visible light onto a cylinder of 0.2 of the width; ultraviolet light around it."""
    r = np.abs(centers(box.shape[0], box.pitch[0])) / (box.radius or 1.0)
    shape = (angles, box.shape[0], box.shape[2])
    visible = np.broadcast_to(np.where(r < 0.4, 1.0, 0.0)[None, :, None], shape)
    ultraviolet = np.broadcast_to(np.where((r > 0.44) & (r < 0.95), 0.6, 0.0)[None, :, None], shape)
    return ColorExposure(
        box, visible, ultraviolet, (ColorExtinction(0.05), ColorExtinction(0.05, extinction)), device=device
    )


def _look(state: Concentrations, places: dict[str, tuple[int, int]], seen: dict[str, list[list[float]]]) -> None:
    a, b, dose = state.a.numpy(), state.b.numpy(), state.dose.numpy()
    for name, (x, y) in places.items():
        seen[name].append([float(field[x, y, field.shape[2] // 2]) for field in (a, b, dose)])


def _curves(axis: Axes, job: PrintRun, seen: dict[str, list[list[float]]], column: int, label: str) -> None:
    time = job.frame_time * (1 + np.arange(job.frames))
    for hue, (name, rows) in zip(style.HUES, seen.items(), strict=False):
        axis.plot(time, np.array(rows)[:, column], color=hue, label=name)
    axis.set(title=label, xlabel="time [s]")
    axis.legend()


def _ripple(course: np.ndarray, angles: int) -> float:
    """Greatest deviation from a straight line over the last turn, over the mean."""
    last = course[-angles:]
    return float(np.abs(last - np.linspace(last[0], last[-1], angles)).max() / max(float(last.mean()), 1e-30))


def _mass(resin: Transport) -> float:
    quiet = replace(resin, reaction=None, diffusivities=(1e-3, 5e-4, 2e-4))
    start = np.random.default_rng(0).random(resin.box.shape)
    state, inside = quiet.start(start), resin.box.open()
    quiet.advance(state, 100 * quiet.limit, 100)
    return abs(float(state.a.numpy()[inside].sum(dtype=np.float64)) / float(start[inside].sum()) - 1.0)


def _beer(job: PrintRun) -> float:
    """Uniform light through uniform resin, within 0.9 of the radius."""
    box, color = job.exposure.box, job.exposure.extinction[1]
    even = replace(job.exposure, visible=None, ultraviolet=np.ones(job.exposure.shape, np.float32))
    found = even.irradiance(job.transport.start(0.0, 0.0, 2.0).c, 7)[1].numpy()[:, :, 0]
    turn, radius = 2 * np.pi * 7 / even.angles, box.radius or 0.0
    x, y = (centers(n, d) for n, d in zip(box.shape[:2], box.pitch, strict=False))
    r = y[None] * np.cos(turn) - x[:, None] * np.sin(turn)
    s = -(x[:, None] * np.cos(turn) + y[None] * np.sin(turn))
    length = np.sqrt(np.maximum(radius**2 - r**2, 0.0)) + s
    wanted = np.exp(-(color.constant + 2.0 * color.per_c) * length)
    return float(np.abs(found - wanted)[np.hypot(x[:, None], y[None]) < 0.9 * radius].max())
