"""How far the surface of simulated prints lies from the mesh they were made from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from profiling.gallery import scene
from profiling.gallery.gaussian import fit_gaussian
from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.methods import optimize
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.metrics.nearest_points import Nearest
from vamgpu.metrics.surface_distance import POINTS, SurfaceDistance, iso_solid, surface_distance
from vamgpu.reports import style
from vamgpu.targets.solid import Solid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STOPS = (0.94, 1.0, 1.06)
"""Doses at which three prints are stopped, relative to the dose with the best overlap."""


def deviation(device: Device, quick: bool = False, pitch: float = 0.12, angles: int = 360) -> Picture:
    """The boat, printed three times, with the stop six percent early, on time, and six percent late."""
    target = scene.boat(device, 0.6 if quick else pitch)
    A = scene.straight(target, 24 if quick else int(angles), device)
    dose = optimize(A, target, iterations=4 if quick else 40).dose().numpy()
    level = 0.5 * float(dose[target.numpy() >= 0.5].min() + dose[target.numpy() < 0.5].max())
    wanted = iso_solid(target.numpy(), target.grid.pitch, name="target")
    prints = [iso_solid(dose, target.grid.pitch, level / stop, f"stop {stop:g}") for stop in STOPS]
    samples = 500 if quick else 20_000
    found = [surface_distance(each, Nearest(wanted), samples=samples) for each in prints]
    figure, axes = style.sheet("aab;ccd", 7.0)
    _map(axes["a"], found[1], "Stopped in time")
    _map(axes["c"], found[2], "Stopped late")
    for name, each in zip("bd", found[1:], strict=True):
        _histogram(axes[name], each)
    facts = [fact for stop, each in zip(STOPS, found, strict=True) for fact in _facts(stop, each)]
    between = print_to_print(prints, samples=samples)
    facts.append(Fact("RMS between prints, mean over the pairs", 1e3 * _mean_of_pairs(between), "µm", 3))
    caption = (
        "Points sampled evenly on the surface of a print and aligned to the target by iterative closest points; red "
        "where the print is too thick, blue where it is too thin. The mean distance shows how early or late the light "
        "was stopped; the width of the Gaussian shows how finely light resolves. The prints are simulated; flow and "
        "shrinkage of the resin are not included. Real prints of the papers have σ of 200–310 µm, and an RMS of 53 µm "
        "from print to print."
    )
    return Picture(figure, caption, tuple(facts), papers=(ROLL_TO_ROLL,))


def _map(axis: Axes, found: SurfaceDistance, title: str) -> None:
    along, up = found.points[:, 0], found.points[:, 2]
    near = np.argsort(-found.points[:, 1])  # nearer points are drawn over farther ones
    limit = 1e3 * float(np.quantile(np.abs(found.distance), 0.99))
    drawn = axis.scatter(along[near], up[near], c=1e3 * found.distance[near], s=2.0, cmap="RdBu_r", vmin=-limit,
                         vmax=limit, linewidths=0)  # fmt: skip
    axis.set(aspect="equal", xlabel="x [mm]", ylabel="z [mm]", title=title)
    axis.grid(False)
    style.bar(drawn, axis, "distance [µm]")


def _histogram(axis: Axes, found: SurfaceDistance) -> None:
    bell = fit_gaussian(found.distance)
    middle = 0.5 * (bell.edges[1:] + bell.edges[:-1])
    axis.stairs(bell.counts, 1e3 * bell.edges, fill=True, color=style.BLUE, alpha=0.4)
    axis.plot(1e3 * middle, bell(middle), color=style.RED)
    axis.set(xlabel="distance [µm]", ylabel="points", title=f"μ {1e3 * bell.mean:.1f} µm, σ {1e3 * bell.sigma:.1f} µm")


def _facts(stop: float, found: SurfaceDistance) -> list[Fact]:
    bell = fit_gaussian(found.distance)
    name = f"stop dose {stop:g}: "
    return [Fact(name + "μ", 1e3 * bell.mean, "µm", 3), Fact(name + "σ", 1e3 * bell.sigma, "µm", 3),
            Fact(name + "R² of the fit", bell.r2, "", 3), Fact(name + "RMS", 1e3 * found.rms, "µm", 3)]  # fmt: skip


def _mean_of_pairs(between: np.ndarray) -> float:
    return float(between[np.triu_indices(len(between), 1)].mean())


def print_to_print(prints: Sequence[Solid], *, aligned: bool = True, samples: int = POINTS) -> npt.NDArray[np.float64]:
    """RMS distance [mm] between each pair of prints, (n, n), symmetric: the repeatability of a machine."""
    # Both directions count equally. The inter-print RMS is the mean over pairs.
    if len(prints) < 2:
        raise BadInput(f"got {len(prints)} prints; expected at least two to compare")
    surfaces = [Nearest(solid) for solid in prints]
    square = np.zeros((len(prints), len(prints)))
    for i, solid in enumerate(prints):
        for j, surface in enumerate(surfaces):
            if i != j:
                square[i, j] = surface_distance(solid, surface, aligned=aligned, samples=samples).rms ** 2
    return np.sqrt(0.5 * (square + square.T))
