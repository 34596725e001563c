"""A film passes the light of a roller: its projection at every angle, and the dose of that light."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.operators.web import WebProjection
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.reports import style
from vamgpu.web import WebGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AGREED, EXACT = 1e-5, 2e-8
"""Allowed differences: from the unfolded matrix, and of the transpose."""


def web(
    device: Device, quick: bool = False, radius: float = 7.5, thickness: float = 3.0, resin_index: float = 1.49,
    bath_index: float = 1.33, absorption: float = 0.22, cell: float = 3.0, length: float = 36.0,
) -> Picture:  # fmt: skip
    """A gyroid film of this length and cell [mm], wound about the roller of roll-to-roll printing in water."""
    step = np.deg2rad(4.0 if quick else 0.5)
    machine = Roller(radius, Film(thickness, resin_index, bath_index, absorption), step, rays=8 if quick else 32)
    pitch = machine.advance
    layers, slices = max(2, round(thickness / pitch)), max(1, round(cell / pitch))
    grid = WebGrid((round(length / pitch), layers, slices), (pitch, thickness / layers, pitch))
    A = WebProjection(grid, machine.beam(pitch, slices), machine, device)
    film = device.upload(_gyroid(grid, cell))
    light = A(film)
    dose = A.T(light).numpy()[..., slices // 2]
    figure, axes = style.sheet("aaa;bbc;ddd", 7.4, height_ratios=[0.55, 1.5, 0.55])
    middle, shown = slices // 2, light.numpy()
    _strip(axes["a"], film.numpy()[..., middle], grid, "The film laid flat, one slice", cmap=style.SOLID, vmax=1.4)
    _light(axes["b"], A, shown[..., middle])
    _pose(axes["c"], A)
    drawn = _strip(axes["d"], dose / dose.max(), grid, "Dose of that light", cmap=style.DOSE, vmin=0)
    style.bar(drawn, axes["d"], "over its largest", location="bottom", shrink=0.3, aspect=40)
    caption = (
        "The light of one angle is traced once. At the next angle, the web has moved by one column and meets the same "
        "light. The projection at every angle is therefore one gather over a shifting window, and the dose is its "
        "exact transpose. Usually the window of every angle is first copied into a matrix; here no such matrix exists. "
        "A window that lies only partly on the web ignores what is beyond its ends. Steps that end between two columns "
        "interpolate."
    )
    return Picture(figure, caption, _facts(A, film.numpy(), shown), papers=(ROLL_TO_ROLL,))


def _gyroid(grid: WebGrid, cell: float) -> np.ndarray:
    """Sheet gyroid, 1 inside; a cell starts at the web's beginning and at the roller's side."""
    x, y, z = np.meshgrid(*(2.0 * np.pi * axis / cell for axis in grid.axes()), indexing="ij")
    level = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    return (np.abs(level) < 0.5).astype(np.float32)


def _strip(axis: Axes, plane: np.ndarray, grid: WebGrid, title: str, **options: Any) -> Any:
    """A slice of the web [l, rho], in mm, the roller's side below."""
    along, deep, _ = grid.size
    drawn = axis.imshow(plane.T, origin="lower", extent=(0, along, 0, deep), aspect="equal", **options)
    axis.set(title=title, xlabel="l along the web [mm]", ylabel="ρ [mm]")
    axis.grid(False)
    return drawn


def _light(axis: Axes, A: WebProjection, light: np.ndarray) -> None:
    """One row of light at every angle."""
    half = 0.5 * A.beam.pixels[0] * A.beam.pitch
    drawn = axis.imshow(light.T, origin="lower", extent=(0, A.motion.poses, -half, half), aspect="auto",
                        cmap=style.LIGHT, vmin=0)  # fmt: skip
    axis.set(title="Its projection at every angle", xlabel="angle", ylabel="column r [mm]")
    axis.grid(False)
    style.bar(drawn, axis, "absorbed share", fraction=0.03)


def _pose(axis: Axes, A: WebProjection) -> None:
    """All light of one angle in its window of the flat film."""
    rays, layers, window = A.light.shape
    field = np.zeros((window, layers))
    np.add.at(field, (A.light.l, A.light.rho), A.light.weight)
    dl, drho, _ = A.grid.edges
    extent = (0, window * dl, 0, layers * drho)
    axis.imshow(field.T, origin="lower", extent=extent, aspect="auto", cmap=style.LIGHT, vmin=0)
    axis.set(title=f"One angle: {rays} rays", xlabel="l in the window [mm]", ylabel="ρ [mm]")
    axis.grid(False)


def _facts(A: WebProjection, film: np.ndarray, light: np.ndarray) -> tuple[Fact, ...]:
    (poses, rays, slices), (_, layers, window) = A.range.shape, A.light.shape
    return (
        Fact("angles that light the web", poses),
        Fact("columns of the window", window),
        Fact("weights of one angle", A.light.weight.size, "", 6),
        Fact("rays", rays),
        Fact("largest difference from the product with the unfolded matrix, over the largest light",
             _gap(A, film, light), "", 2, AGREED, bound="≤"),
        Fact("gap between ⟨Ax, y⟩ and ⟨x, Aᵀy⟩ over the norms of Ax and y", A.dot_test(), "", 2, EXACT, bound="≤"),
        Fact("the unfolded matrix would take", 4e-6 * layers * window * poses * slices, "MB", 4),
        Fact("tables that both directions use instead", 1e-6 * A.nbytes, "MB", 3),
    )  # fmt: skip


def _gap(A: WebProjection, film: np.ndarray, light: np.ndarray) -> float:
    """Comparison with the unfolded matrix of the middle slice, in float64."""
    window, middle = A.light.shape[2], film.shape[2] // 2
    ends = np.zeros((window - 1, film.shape[1]))
    long = np.concatenate([ends, film[..., middle].astype(np.float64), ends])
    unfolded = np.lib.stride_tricks.sliding_window_view(long, window, axis=0)  # [pose, rho, l]
    wanted = np.tensordot(unfolded, A.light.moving.dense(), axes=((1, 2), (1, 2)))
    return float(np.abs(light[..., middle] - wanted).max() / wanted.max())
