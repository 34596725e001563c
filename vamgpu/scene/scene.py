"""Bodies in one CAD frame, and their effect on voxels and light."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from math import ceil, inf, isfinite, prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.card import card
from vamgpu.errors import BadInput, EmptyMesh, OutOfMemory, TargetTooLarge
from vamgpu.geometry import Beam, Grid, Turntable, Vessel, centers, counts, positive
from vamgpu.operators.bundle import RayBundle
from vamgpu.operators.medium import CoRotatingMedium
from vamgpu.operators.projection import Projection
from vamgpu.operators.traced_projection import TracedProjection
from vamgpu.optics.graded_vial import GradedVial
from vamgpu.optics.occluder import Occluded
from vamgpu.quantity import meant
from vamgpu.scene.body import FREE, PRINTED, Body, Place
from vamgpu.scene.named import named_bodies
from vamgpu.schema.quantities import Length, measured
from vamgpu.storage.memory import MEMORY, budget, size
from vamgpu.targets.limits import Limits
from vamgpu.targets.solid import Solid
from vamgpu.targets.target import LARGEST, MARGIN, SMALLEST, Target, check_thickness

MULTIPLE = 4  # default grids have multiples of this many voxels along every axis
HALF = 0.5  # least filled share of a voxel that belongs to a body
SMALL = 0.5  # size [mm] below which a body's file is probably not in mm
SHARES = 64.0  # number of levels of a voxel's opaque share: rounding to them makes equal shares exactly equal
RAYS = 3  # rays of a pixel past inserts; fewer leave stripes if pixels and voxels have the same size


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies in one CAD frame: those to print, their dose, and those in the path of the light.

    Bodies keep their positions relative to each other; the frame may be turned and scaled as a whole.

    Args:
        bodies: The bodies; at least one is ``print`` or ``gray``.
        factor: Scale of the CAD frame, dimensionless.
        orientation: Rotation matrix of the CAD frame, (3, 3), applied first.
        origin: Point of the CAD frame that is placed at the middle of the axis, (x, y, z) [mm before ``factor``]; by
            default x = y = 0 and the middle of the printed bodies.
        void: Limit of the dose outside all bodies, relative to the dose that prints; by default the least gray dose, at
            most 1.

    Raises:
        BadInput: A value is out of its range, or nothing is to be printed.
    """

    bodies: Sequence[Body]
    factor: float = 1.0
    orientation: npt.ArrayLike | None = None
    origin: tuple[float, float, float] | None = None
    void: float | None = None
    _known: dict[Grid, _Shares] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.bodies, (Body, Iterable)):
            raise BadInput(f"got a {type(self.bodies).__name__} as bodies; expected a list of Body(source, role)")
        bodies = (self.bodies,) if isinstance(self.bodies, Body) else tuple(self.bodies)
        wrong = next((body for body in bodies if not isinstance(body, Body)), None)
        if wrong is not None:
            raise BadInput(f"got a {type(wrong).__name__} among the bodies; expected Body(source, role)")
        if not any(body.role in PRINTED for body in bodies):
            raise BadInput(f"none of {len(bodies)} bodies is to be printed; expected one of role print or gray")
        object.__setattr__(self, "bodies", bodies)
        positive("factor", self.factor)
        if self.void is not None:
            positive("void", self.void)
        origin = None if self.origin is None else np.asarray(self.origin, np.float64)
        if origin is not None and (origin.shape != (3,) or not np.isfinite(origin).all()):
            raise BadInput(f"origin is {self.origin!r}; expected three finite lengths (x, y, z)")

    @classmethod
    def from_3mf(
        cls, path: str | Path, *, roles: Literal["names"] | None = None, dose: float | None = None, **settings: Any
    ) -> Scene:
        """The objects of a 3MF file as bodies, where they were drawn.

        Args:
            path: The file.
            roles: "names", which begin with roles, as "insert rod" or "zero-dose pore". Other objects are printed.
            dose: Limit for bodies to keep out, relative to the dose that prints.
            settings: Arguments of the scene: ``factor``, ``orientation``, ``origin``, ``void``.

        Returns:
            The scene.

        Raises:
            BadInput: ``roles`` is not "names", no name has a role, a limit is missing, or nothing is to be printed.
            MeshError: The file is damaged.
        """
        return cls(named_bodies(path, roles, dose=dose), **settings)

    def _repr_html_(self) -> str:
        return card("Scene", {f"{k}: {body.name}": body.summary(self.place) for k, body in enumerate(self.bodies, 1)})

    @property
    def inserts(self) -> tuple[Body, ...]:
        """The bodies in the path of the light."""
        return tuple(body for body in self.bodies if body.role == "insert")

    @property
    def printed(self) -> tuple[Body, ...]:
        """The bodies that are printed."""
        return tuple(body for body in self.bodies if body.role in PRINTED)

    @property
    def place(self) -> Place:
        """Transform of the CAD frame."""
        turn = None if self.orientation is None else np.asarray(self.orientation, np.float64)
        if self.origin is not None:
            at = np.asarray(self.origin, np.float64)
            x, y, z = -self.factor * (at if turn is None else turn @ at)
            return Place(self.factor, turn, (float(x), float(y), float(z)))
        _, low, high = self._reach(Place(self.factor, turn, (0.0, 0.0, 0.0)))
        return Place(self.factor, turn, (0.0, 0.0, -0.5 * (low + high) if low < high else 0.0))

    def _reach(self, place: Place) -> tuple[float, float, float]:
        """Radius, lowest and highest z [mm] of all printed bodies, as far as known."""
        known = [reach for body in self.printed if (reach := body.reach(place)) is not None]
        if not known:
            return 0.0, inf, -inf
        return max(r for r, _, _ in known), min(low for _, low, _ in known), max(high for _, _, high in known)

    def grid(self, pitch: float | str, *, margin: int = MARGIN, shape: tuple[int, int, int] | None = None) -> Grid:
        """Voxels that hold all printed bodies and inserts.

        Args:
            pitch: Voxel edge [mm], or text with its unit.
            margin: Empty voxels between the bodies and the inscribed cylinder.
            shape: Voxels of the grid; by default the smallest multiples of 4 that hold the bodies and the margin.
                Needed if a printed body or an insert is a function.

        Returns:
            The grid.

        Raises:
            BadInput: A value is out of its range.
            TargetTooLarge: The printed bodies do not fit ``shape``.
        """
        pitch, place = measured("pitch", pitch, Length), self.place
        free = positive("margin [voxels]", margin, zero=True)
        radius, low, high = self._reach(place)
        if (size := max(2.0 * radius, high - low)) > LARGEST and isfinite(size):
            unit = meant(size / self.factor, SMALLEST, LARGEST)
            likely = f" (was it drawn in {unit}?)" if unit else ""
            raise BadInput(f"what is printed is {size:.4g} mm wide or high about the axis; expected {LARGEST:g} mm at "
                           f"most: check the unit{likely}, the factor or the origin")  # fmt: skip
        along = 2.0 * max(abs(low), abs(high)) / pitch - 1e-6 if low < high else 0.0
        across = 2.0 * (radius / pitch + free) + 1.0 - 1e-6
        if shape is not None:
            grid = Grid(counts("shape", shape, 3), pitch)  # type: ignore[arg-type]
            if radius and (across > min(grid.shape[:2]) or along > grid.shape[2]):
                raise TargetTooLarge(
                    f"what is printed reaches {radius:.4g} mm from the axis and {0.5 * along * pitch:.4g} mm up or "
                    f"down; expected it within shape {grid.shape} of {pitch:g} mm: use shape ({ceil(across)}, "
                    f"{ceil(across)}, {ceil(along)}), or another origin"
                )
            return grid
        standing = [(body, body.reach(place)) for body in (*self.printed, *self.inserts)]
        unknown = next((body.name for body, reach in standing if reach is None), None)
        if unknown is not None:
            raise BadInput(f"body {unknown!r} is a function, whose extent is unknown; give shape=")
        widest = max(reach[0] for _, reach in standing if reach is not None)
        n, nz = (MULTIPLE * ceil(n / MULTIPLE) for n in (2.0 * (widest / pitch + free) + 1.0 - 1e-6, along))
        return Grid((n, n, max(nz, MULTIPLE)), pitch)

    def target(
        self, *, pitch: float | str, margin: int = MARGIN, shape: tuple[int, int, int] | None = None,
        device: str | Device | None = None, name: str | None = None,
    ) -> Target:  # fmt: skip
        """Target with the required dose of every voxel.

        Args:
            pitch: Voxel edge [mm], or text with its unit.
            margin: Empty voxels between the bodies and the inscribed cylinder.
            shape: Voxels of the grid; see `grid`.
            device: Device that voxelizes meshes, or its name; the best available one by default.
            name: Name in messages and reports; by default that of the first printed body.

        Returns:
            The target; its `limits` hold the dose that each voxel requires.

        Raises:
            BadInput: A value is out of its range.
            EmptyMesh: A body fills no voxel, or other bodies cover all of it.
            TargetTooLarge: The printed bodies do not fit ``shape``.
        """
        grid = self.grid(pitch, margin=margin, shape=shape)
        found, name = self._shares(grid, open_device(device)), name or str(self.printed[0].name)
        fraction, radius, place = found.fraction, self._reach(self.place), self.place
        for body in self.printed:
            if (solid := body.solid(self.place)) is not None:
                check_thickness(solid, grid.pitch)
        target = Target.from_array(fraction, grid.pitch, name)
        exact = all(body.reach(place) is not None for body in self.printed)
        limits = None if self._plain else found.limits(self)
        solid = self.printed[0].solid(place) if self._plain and len(self.bodies) == 1 else None
        return Target(
            grid, name, target.fraction, radius[0] if exact else target.radius, target.volume,
            2.0 * max(abs(radius[1]), abs(radius[2])) if exact else grid.shape[2] * grid.pitch, solid, limits,
        )  # fmt: skip

    @property
    def _plain(self) -> bool:
        """Whether all bodies are plain parts to print."""
        return self.void in (None, 1.0) and all(body.role == "print" and body.weight == 1.0 for body in self.bodies)

    def _shares(self, grid: Grid, device: Device) -> _Shares:
        if grid not in self._known:
            self._afford(grid)
            filled = [body.fractions(grid, self.place, device) for body in self.bodies]
            self._known[grid] = _Shares.of(self, filled)
        return self._known[grid]

    def _afford(self, grid: Grid) -> None:
        """Raise `OutOfMemory` if the bodies take more than the budget."""
        need, most = prod(grid.shape) * max(40 + 8 * len(self.bodies), 130 if self.inserts else 0), budget()
        if need > most:
            raise OutOfMemory(
                f"{len(self.bodies)} bodies on {' × '.join(map(str, grid.shape))} voxels of {grid.pitch:.4g} mm take "
                f"{size(need)} of memory; the budget is {size(most)}: use a pitch of "
                f"{grid.pitch * (need / most) ** (1 / 3) * 1.01:.2g} mm or more, or raise the budget with {MEMORY}"
            )

    def medium(
        self, grid: Grid, *, resin_index: float | None = None, absorption: float = 0.0,
        device: str | Device | None = None,
    ) -> CoRotatingMedium:  # fmt: skip
        """The inserts as a medium for light, in resin that fills the inscribed cylinder of a grid.

        Args:
            grid: Voxels.
            resin_index: Refractive index of the resin; needed if an insert has an index.
            absorption: Absorption of the resin [1/mm].
            device: Device that voxelizes meshes.

        Returns:
            The medium; [x, y] if nothing depends on z.

        Raises:
            BadInput: An insert has an index, but the resin has none.
        """
        found = self._shares(grid, open_device(device))
        solid, index = np.zeros(grid.shape), np.full(grid.shape, 0.0 if resin_index is None else resin_index)
        resin = np.broadcast_to((absorption * disc_of(grid))[:, :, None], grid.shape)
        extinction = resin.copy()
        for body, share in zip(self.bodies, found.shares, strict=True):
            if body.role != "insert":
                continue
            if body.opaque:
                solid += share
                continue
            extinction += share * ((body.absorption or 0.0) - resin)  # shares of inserts that touch add up
            if body.index is not None:
                if resin_index is None:
                    raise BadInput(f"insert {body.name!r} has the index {body.index:g}, but the resin has none; "
                                   "expected a vessel with an index, or resin_index=")  # fmt: skip
                index += share * (body.index - resin_index)
        bends = any(body.index is not None for body in self.inserts)
        known = [each for each in (resin_index, *(body.index for body in self.inserts)) if each is not None]
        index = np.clip(index, min(known, default=0.0), max(known, default=0.0))  # but for the rounding of shares
        absorbs = absorption > 0.0 or any(body.absorption for body in self.inserts)
        solid = np.rint(np.minimum(solid, 1.0) * SHARES) / SHARES
        fields = [
            index if bends else None,
            np.maximum(extinction, 0.0) if absorbs else None,
            solid if solid.any() else None,
        ]
        level = all(values is None or (values == values[:, :, :1]).all() for values in fields)
        index_, extinction_, opaque = (values[:, :, 0] if level and values is not None else values for values in fields)
        return CoRotatingMedium(index_, extinction_, opaque)

    def operator(
        self, target: Target, beam: Beam, motion: Turntable, vessel: Vessel | None = None, *, rays: int = RAYS,
        resin_index: float | None = None, device: str | Device | None = None,
    ) -> Projection | TracedProjection:  # fmt: skip
        """The projector of a beam past the inserts.

        Args:
            target: Made by `target`.
            beam: Its pixels, without ``fill`` and ``spread`` if there are inserts.
            motion: The turntable.
            vessel: The vessel of the resin; None for straight light without absorption.
            rays: Rays per pixel, if there are inserts.
            resin_index: Refractive index of the resin, if the vessel has none.
            device: A name or a device; the best available one by default.

        Returns:
            A `Projection`, or with inserts a `TracedProjection` whose rays the vessel refracts and the resin absorbs.

        Raises:
            BadInput: The vessel bends light in the resin, or an argument is out of its range.
            TargetTooLarge: The printed bodies reach beyond the printable radius.
        """
        getattr(vessel, "check_fits", lambda radius: None)(target.radius)
        if not self.inserts:
            return Projection(target.grid, beam, motion, vessel, device)
        index, absorption = resin_of(vessel)
        index = index if resin_index is None else resin_index
        medium = self.medium(target.grid, resin_index=index, absorption=absorption, device=device)
        return through(medium, target.grid, beam, motion, vessel, rays, device)


def _drawn(body: Body) -> str:
    """Where a mesh was drawn, in words, and for a very small one its likely unit."""
    if not isinstance(body.source, Solid):
        return ""
    low, high = body.source.bounds
    size = float(np.max(high - low))
    said = ", ".join(f"{axis} {a:.3g}..{b:.3g}" for axis, a, b in zip("xyz", low, high, strict=True))
    small = "; drawn in inches it needs the factor 25.4, in metres 1000" if size < SMALL else ""
    return f", which was drawn at {said} mm{small},"


def resin_of(vessel: Vessel | None) -> tuple[float | None, float]:
    """Index, if any, and absorption of the resin of a vessel. Raises `BadInput` if light bends or is cut in it."""
    if isinstance(vessel, (GradedVial, Occluded)):
        raise BadInput(f"got {type(vessel).__name__} with inserts or a medium in resin; expected a vessel in whose "
                       "resin light runs straight, such as a Vial")  # fmt: skip
    round_one = getattr(vessel, "inner", vessel)  # without what only moves the light
    return getattr(round_one, "resin_index", None), 0.0 if vessel is None else vessel.absorption


def through(
    medium: CoRotatingMedium, grid: Grid, beam: Beam, motion: Turntable, vessel: Vessel | None, rays: int,
    device: str | Device | None,
) -> TracedProjection:  # fmt: skip
    """The projector of a beam that a vessel refracts, through a medium that turns with the resin."""
    rows = 1 if medium.is_level else ceil(beam.pitch / grid.pitch - 1e-6)
    bundle = refracted(grid, beam, vessel, counts("rays", (rays,), 1)[0], rows)
    return TracedProjection(grid, beam, motion, medium, bundle, device)


def refracted(grid: Grid, beam: Beam, vessel: Vessel | None, rays: int, rows: int) -> RayBundle:
    """Rays of a beam in the resin of a vessel, side by side in each pixel, and in ``rows`` above one another."""
    across = (np.arange(rays) + 0.5) / rays - 0.5
    u = beam.columns()[:, None] + beam.pitch * across
    p, angle, share = u, np.zeros_like(u), np.ones_like(u)
    if vessel is not None:
        chords = vessel.chords(u)
        lit = chords.transmittance > 0
        p, angle, share = (np.where(lit, values, 0.0) for values in (chords.p, chords.angle, chords.transmittance))
        if vessel.absorption > 0:
            inner = np.sqrt(np.maximum(_circle(grid) ** 2 - p**2, 0.0))
            outside = np.maximum(0.5 * np.where(lit, chords.length, 0.0) - inner, 0.0)
            share = share * np.exp(-vessel.absorption * outside)
    p, angle, share = (np.tile(values, rows) for values in (p, angle, share))
    z = np.repeat(centers(rows, beam.pitch / rows), rays) + np.zeros_like(p)
    start = np.stack([p * np.cos(angle), p * np.sin(angle), z], axis=-1)[:, None]
    heading = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(p)], axis=-1)[:, None]
    return RayBundle(start, heading, share[:, None] / (rays * rows))


def _circle(grid: Grid) -> float:
    """Radius [mm] about the axis within which a medium has the resin's absorption."""
    return 0.5 * min(grid.shape[:2]) * grid.pitch


def disc_of(grid: Grid) -> npt.NDArray[np.float64]:
    """Share of every column of voxels inside that circle, [x, y]."""
    x, y, _ = grid.axes()
    return np.clip((_circle(grid) - np.hypot(x[:, None], y[None, :])) / grid.pitch + 0.5, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class _Shares:
    """The body that each voxel belongs to."""

    shares: list[npt.NDArray[np.floating]]
    fraction: npt.NDArray[np.float32]
    owner: npt.NDArray[np.int16]

    @classmethod
    def of(cls, scene: Scene, filled: list[npt.NDArray[np.float32]]) -> _Shares:
        """Resolve overlaps of the shares that the bodies fill separately."""
        bodies, shape = scene.bodies, filled[0].shape
        room = np.ones(shape, np.float32)
        shares = list(filled)
        for k in sorted(range(len(bodies)), key=lambda k: (bodies[k].priority, k), reverse=True):
            shares[k] = np.minimum(filled[k], room)
            room = room - shares[k]
        made, free = (
            sum((share for body, share in zip(bodies, shares, strict=True) if body.role in roles), np.zeros(shape))
            for roles in (PRINTED, FREE)
        )
        asked = free < HALF
        fraction = np.where(asked, np.minimum(made / np.maximum(1.0 - free, HALF), 1.0), 0.0).astype(np.float32)
        owner, most = np.full(shape, -1, np.int16), np.where(fraction >= HALF, 0.0, room)
        for k, body in enumerate(bodies):
            mine = asked & ((fraction >= HALF) == (body.role in PRINTED))
            may = ~asked if body.role in FREE else mine
            wins = may & (shares[k] > 0.0) & (shares[k] >= np.where(asked, most, 0.0))
            owner[wins], most[wins] = k, shares[k][wins]
        found = cls(shares, fraction, owner)
        found._check(bodies, filled)
        return found

    def _check(self, bodies: Sequence[Body], filled: list[npt.NDArray[np.float32]]) -> None:
        for k, body in enumerate(bodies):
            if not filled[k].any():
                raise EmptyMesh(f"body {body.name!r}{_drawn(body)} fills no voxel of {filled[k].shape}; expected "
                                "some: check where it was drawn and its scale, or use a finer pitch or a wider "
                                "shape")  # fmt: skip
            if body.role not in PRINTED or (self.owner == k).any():
                continue
            if not (filled[k] >= HALF).any():
                raise EmptyMesh(f"body {body.name!r}{_drawn(body)} fills no voxel by half: use a finer pitch")
            there = set(self.owner[filled[k] >= HALF].tolist()) - {-1}
            over = ", ".join(repr(bodies[n].name) for n in sorted(there)) or "others"
            raise EmptyMesh(
                f"nothing is left of body {body.name!r}: carved away by {over}; expected some voxels: move it, or "
                "give it a higher priority"
            )

    def limits(self, scene: Scene) -> Limits:
        """Required dose of every voxel."""
        bodies = scene.bodies
        grays = [body.dose for body in bodies if body.role == "gray" and body.dose is not None]
        void = min([1.0, *grays]) if scene.void is None else scene.void
        dose = [0.0 if body.role in FREE else body.requirement.dose for body in bodies]
        weight = [body.weight for body in bodies]
        return Limits(
            np.array([*dose, void], np.float32)[self.owner], np.array([*weight, 1.0], np.float32)[self.owner],
            self.owner, tuple(body.requirement for body in bodies), void,
        )  # fmt: skip
