"""Light through resin with a cured lens that turns with it, and around an insert that also turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.kernels.medium import MARGIN, march
from vamgpu.methods import optimize
from vamgpu.methods.papers import THRESHOLDS
from vamgpu.operators.bundle import RayBundle
from vamgpu.operators.medium import CoRotatingMedium
from vamgpu.operators.projection import Projection
from vamgpu.operators.traced_projection import TracedProjection
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHARMA = "A. Sharma, D. Kumar, A. Ghatak, Tracing rays through graded-index media, Appl. Opt. 21 (1982) 984"
SIZE = 10.0  # mm, edge of the grid


@dataclass(frozen=True)
class Scene:
    """One slice: its grid, beam and angles, a cured lump off the axis and an insert."""

    grid: Grid
    beam: Beam
    motion: Turntable
    lens: CoRotatingMedium
    steel: np.ndarray
    device: Device

    def traced(self, medium: CoRotatingMedium | None = None) -> Any:
        return TracedProjection(self.grid, self.beam, self.motion, medium, device=self.device)

    @property
    def plane(self) -> tuple[np.ndarray, np.ndarray]:
        x, y, _ = self.grid.axes()
        return x[:, None], y[None, :]


def carried(
    device: Device,
    quick: bool = False,
    resin_index: float = 1.485,
    cured_step: float = 0.04,
    lump_radius: float = 1.2,
    lump_x: float = 1.9,
    lump_y: float = -1.0,
    insert_radius: float = 0.9,
    insert_x: float = 0.5,
    insert_y: float = 0.4,
) -> Picture:
    """A lump cured beforehand, off the axis, that turns with the resin; and a rod that stops the light."""
    n, iterations = (40, 10) if quick else (128, 60)
    grid = Grid((n, n, 1), SIZE / n)
    x, y = (axis for axis in (grid.axes()[0][:, None], grid.axes()[1][None, :]))
    cured = np.exp(-((x - lump_x) ** 2 + (y - lump_y) ** 2) / lump_radius**2)
    steel = (x - insert_x) ** 2 + (y - insert_y) ** 2 <= insert_radius**2
    lens = CoRotatingMedium(index=resin_index + cured_step * cured, bath=resin_index)
    scene = Scene(grid, Beam((n, 1), grid.pitch), Turntable(2 * n), lens, steel, device)
    figure, axes = style.sheet("abc;def", 7.2)
    bent = _paths(axes["a"], scene, cured_step / resin_index, lump_radius, (lump_x, lump_y))
    lensed = _lensed(axes["b"], axes["c"], scene, iterations)
    shaded = _insert(axes["d"], axes["e"], axes["f"], scene, iterations)
    caption = (
        "Cured resin refracts. A lump off the axis is a lens that turns with the vial, so the rays of one angle do not "
        "serve the others, and every ray is traced again at each angle. Top: its rays at three angles, in the resin's "
        "own coordinates. Patterns planned for straight rays deposit their dose in the wrong place; patterns planned "
        "through the lens print correctly. Bottom: overprinting. A rod stops the light; the resin behind it at one "
        "angle must be lit from others. If the plan ignores the rod, the part keeps its shadows; if it includes the "
        "rod, they are filled."
    )
    return Picture(figure, caption, (*bent, *lensed, *shaded), papers=(SHARMA, THRESHOLDS))


def _paths(axis: Axes, scene: Scene, step: float, width: float, center: tuple[float, float]) -> list[Fact]:
    """Rays at three angles, and their greatest deflection compared with the formula of a weak lens."""
    size, pitch = scene.grid.shape[0], scene.grid.pitch
    beam = Beam((121, 1), 0.7 * SIZE / 121)
    poses = np.radians([10.0, 130.0, 250.0])
    medium = scene.lens.samples(scene.grid)
    starts = RayBundle.parallel(beam).table(scene.grid, beam, level=True, unit=pitch)
    tracks = _tracks(medium, starts, poses)
    x, y = scene.plane
    lump = np.hypot(*np.broadcast_arrays(x - center[0], y - center[1])) < width
    axis.contourf(x[:, 0], y[0], lump.T, levels=[0.5, 1.5], colors=[style.GLASS])
    for pose, hue in enumerate((style.BLUE, style.ORANGE, style.GREEN)):
        for ray in range(4, 121, 8):
            track = (tracks[pose * 121 + ray] - 0.5 * (size - 1)) * pitch
            axis.plot(track[:, 0], track[:, 1], color=hue, lw=0.7)
    half = 0.5 * SIZE
    axis.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", title="Rays at 10°, 130° and 250°")
    axis.set(xlabel="x [mm]", ylabel="y [mm]")
    axis.grid(False)
    turns = [_turn(track) for track in tracks]
    # ∫∇n ds / n of a Gaussian at distance b is 2·√π·step·(b/w)·exp(−b²/w²), greatest at b = w/√2
    weak = np.sqrt(2.0 * np.pi) * step * np.exp(-0.5)
    return [Fact("greatest deflection of a ray", float(np.degrees(max(turns))), "°",
                 expected=float(np.degrees(weak)), source="weak lens, to first order")]  # fmt: skip


def _tracks(medium: np.ndarray, starts: np.ndarray, poses: np.ndarray) -> list[np.ndarray]:
    """Midpoints of the steps of every ray [index of x, y]."""
    directions = np.stack([np.cos(poses), np.sin(poses)], axis=1)
    tracks: list[list[np.ndarray]] = [[] for _ in range(len(poses) * len(starts))]
    left, most = np.zeros(len(tracks), int), 8 * (medium.shape[0] + MARGIN)
    for ray, middle, _ in march(medium, starts, directions, 1e6, 0.5, most, 1, left):
        for index, point in zip(ray, middle[:, :2], strict=True):
            tracks[index].append(point)
    return [np.array(track) for track in tracks]


def _turn(track: np.ndarray) -> float:
    """Angle [rad] between the first and the last step of a path."""
    first, last = track[1] - track[0], track[-1] - track[-2]
    return float(abs(np.arctan2(first[0] * last[1] - first[1] * last[0], first @ last)))


def _lensed(before: Axes, after: Axes, scene: Scene, iterations: int) -> list[Fact]:
    """Patterns planned without and with the lens, both exposed through it."""
    x, y = scene.plane
    part = (np.abs(np.hypot(x, y) - 2.6) < 0.7) & ~((np.abs(y) < 0.35) & (x < 0))
    lens, air = scene.traced(scene.lens), scene.traced()
    straight, bent = _light(air, part, iterations), _light(lens, part, iterations)
    ignored, known = (lens.T(light)[..., 0] for light in (straight, bent))
    untouched = air.T(straight)[..., 0]
    _dose(before, ignored, part, scene, "Planned for straight light")
    _dose(after, known, part, scene, "Planned through the lump")
    disc = scene.grid.cylinder()
    return [
        Fact("window of patterns planned straight, along straight rays", _window(untouched, part, disc), "", 3),
        Fact("the same patterns through the lump", _window(ignored, part, disc), "", 3),
        Fact("window of patterns planned through the lump", _window(known, part, disc), "", 3),
        Fact("transpose: |⟨Ax, y⟩ − ⟨x, Aᵀy⟩| / (‖Ax‖‖y‖)", lens.dot_test(), "", 2, 2e-8, bound="≤"),
        Fact("largest difference from the plain projection without lump or rod", 100 * _gap(air, scene), "%", 2),
    ]


def _insert(alone: Axes, before: Axes, after: Axes, scene: Scene, iterations: int) -> list[Fact]:
    """The shadow of the rod at one angle; patterns planned without and with it, both exposed around it."""
    x, y = scene.plane
    blocked, free = scene.traced(CoRotatingMedium(opaque=scene.steel)), scene.traced()
    one = np.zeros(blocked.range.shape)
    one[scene.motion.angles // 12] = 1.0
    shadow = blocked.T(one)[..., 0] / scene.grid.pitch
    drawn = style.shown(alone, shadow, "The rod's shadow at 30°", scene.grid.pitch, cmap=style.LIGHT, vmin=0)
    style.bar(drawn, alone, "light over that of the beam")
    part = (np.abs(np.hypot(x, y) - 2.6) < 0.7) & ~scene.steel
    disc = scene.grid.cylinder() & ~scene.steel
    doses = [blocked.T(_light(A, part, iterations))[..., 0] for A in (free, blocked)]
    _dose(before, doses[0], part, scene, "Planned without the rod")
    _dose(after, doses[1], part, scene, "Planned around the rod")
    dark = float((shadow[scene.steel] == 0).mean())
    return [
        Fact("share of the rod's voxels that get no light", 100 * dark, "%", expected=100.0, source="opaque"),
        Fact("window around the rod, planned without it", _window(doses[0], part, disc), "", 3),
        Fact("window around the rod, planned with it", _window(doses[1], part, disc), "", 3),
    ]


def _light(A: Any, part: np.ndarray, iterations: int) -> np.ndarray:
    return optimize(A, part.astype(np.float32)[..., None], iterations=iterations).sinogram.numpy()


def _window(dose: np.ndarray, part: np.ndarray, where: np.ndarray) -> float:
    """(Least dose in the part − greatest outside) / greatest."""
    inside, outside = dose[part & where], dose[~part & where]
    return float((inside.min() - outside.max()) / max(inside.max(), outside.max()))


def _gap(traced: Any, scene: Scene) -> float:
    x, y = scene.plane
    smooth = np.exp(-((x - 0.8) ** 2 + (y + 0.5) ** 2) / 1.5)[..., None]
    plain = Projection(scene.grid, scene.beam, scene.motion, device=scene.device)(smooth)
    return float(np.abs(traced(smooth) - plain).max() / plain.max())


def _dose(axis: Axes, dose: np.ndarray, part: np.ndarray, scene: Scene, title: str) -> None:
    x, y = scene.plane
    style.shown(axis, dose / dose[part].mean(), title, scene.grid.pitch, vmin=0.4, vmax=1.2)
    axis.contour(x[:, 0], y[0], part.T.astype(float), levels=[0.5], colors="white", linewidths=0.6)
    axis.set(xlabel="x [mm]")
