"""A roller that carries a film past the light."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, RayError
from vamgpu.geometry import Beam, centers, positive
from vamgpu.optics.faces import Face, transmit
from vamgpu.optics.film import Coverage, Film, coverage
from vamgpu.optics.inputs import Floats, as_offsets
from vamgpu.optics.interface import Polarization, polarized
from vamgpu.optics.roller_cells import cells
from vamgpu.optics.roller_index import FilmIndex
from vamgpu.optics.roller_rays import Layers, Traced, trace
from vamgpu.optics.wrap_map import WrapMap
from vamgpu.schema import check
from vamgpu.schema.quantities import Count, Gain, HalfAngle, Index, Length, Place, Share, Step, Thickness
from vamgpu.web import Propagation, WebGrid

Volume = Literal["flat", "bent"]
LARGEST_GAIN = 2.0
"""Default gain at which the compensation of Fresnel's loss is clipped; without a limit it would diverge."""
SAME = 1e-6  # relative difference up to which the thickness of a grid counts as that of the film


@dataclass(frozen=True)
class Roller:
    """A film wrapped by half a turn about an opaque roller, as in Toombs et al., Fig. 2; a `vamgpu.web.Wrap`.

    The axis of the roller is (0, 0). Light travels towards +y and meets the film at y = −√(r_o² − x²). It refracts
    there by Snell's law with Fresnel's loss, continues straight, and is absorbed by Beer and Lambert's law. It ends at
    the roller, in the bath, or at the end of one of the two straight runs ("legs") before and after the roller.

    Args:
        radius: Radius of the roller [mm].
        film: The film around it.
        step: Rotation from one angle to the next [rad].
        legs: Length of each straight run in the window [mm]; None for the depth in which light falls to 5 %.
        reflectivity: Share of the light that the roller reflects, specular.
        compensation: Largest factor by which columns compensate Fresnel's loss, see `gain`; None for no compensation.
            It is part of the beam: a projector with equally bright columns must show frames multiplied by `gain`.
        divergence: Half angle of the fan of light of each column in the bath [rad], uniform in its sine, centered where
            the column is in focus.
        planes: Depths [mm] of the projector's focus planes along the light from the axis, < 0 before it. Each column is
            in focus at the plane nearest to where it meets the middle of the film, as in `vamgpu.FocusMasks`. None:
            each column is in focus exactly at the film's middle.
        lit_share: Share of each step during which its frame is lit while the film moves, half of it before the angle; 0
            for a film that stops while it is lit. With a lens, the focus planes divide this time.
        neutral: Depth of the line that bending does not stretch, as a share of the thickness, measured from the roller.
        rays: Rays across the width of a column; if the walls of a voxel are parallel to the light, the voxel's share of
            a column is accurate to one ray.
        fan: Rays across the fan of a column.
        index: Refractive index of the resin if it varies in space. Rays are then marched through the film, on a device
            if the index is a field. Coverage, gain and aperture still use the index of the film.
        polarization: Polarization of the light: "none", "s" (its field along the roller's axis) or "p" (across it).
        core: Index of a transparent roller: light passes through it and the bath behind it, and re-enters the film.
            None for a roller that absorbs or reflects light.
        volume: Volume by which absorbed energy is divided: that of the "flat" film, which conserves energy when the
            film is laid flat, or that of the "bent" film. Their ratio is the radius over that of the neutral line.

    Raises:
        BadInput: A value is out of its range.
        RayError: The length of straight runs is not given, but the film absorbs nothing.
    """

    radius: Length
    film: Film
    step: Step
    legs: Thickness | None = None
    reflectivity: Share = 0.0
    compensation: Gain | None = None
    divergence: HalfAngle = 0.0
    neutral: Share = 0.5
    rays: Count = 32
    fan: Count = 9
    index: FilmIndex | None = None
    polarization: Polarization = "none"
    core: Index | None = None
    volume: Volume = "flat"
    planes: tuple[Place, ...] | None = None
    lit_share: Share = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.film, Film):
            raise BadInput(f"Roller film is {self.film!r}; expected a Film")
        if self.index is not None and not isinstance(self.index, FilmIndex):
            raise BadInput(f"Roller index is {self.index!r}; expected a FilmIndex, or None for the film's own")
        check(self)
        polarized("Roller polarization", self.polarization)
        if self.volume not in get_args(Volume):
            raise BadInput(f"Roller volume is {self.volume!r}; expected 'flat' or 'bent'")
        if self.planes is not None and (not self.planes or (np.diff(self.planes) <= 0.0).any()):
            raise BadInput(f"Roller planes are {self.planes!r}; expected one or more rising depths [mm], or None")
        if self.core is not None and self.reflectivity:
            raise BadInput(
                f"the roller is clear, of index {self.core:g}, and reflects {self.reflectivity:g}; expected one of "
                "core and reflectivity"
            )
        if self.legs is None and self.film.penetration == inf:
            raise RayError(
                "the film absorbs nothing, so that a ray along a straight run never leaves the window; expected the "
                "length of the straight runs [mm], or a film with an absorption above 0"
            )

    @property
    def marched(self) -> bool:
        """Whether `propagation` computes on a device."""
        return self.index is not None and self.index.medium is not None

    @property
    def outer(self) -> float:
        """r_o [mm]: radius of the film's outer face."""
        return self.radius + self.film.thickness

    @property
    def neutral_radius(self) -> float:
        """Radius [mm] at which the film moves as fast as the flat web; by default r_i + τ/2."""
        return self.radius + self.neutral * self.film.thickness

    @property
    def advance(self) -> float:
        """Distance [mm] that the web moves along its neutral line from one angle to the next."""
        return self.step * self.neutral_radius

    @property
    def leg(self) -> float:
        """Length [mm] of each straight run."""
        return self.film.penetration if self.legs is None else self.legs

    @property
    def faces(self) -> tuple[Face, ...]:
        """The curved faces light crosses, from the outside in."""
        return self.film.faces(self.radius)

    @property
    def aperture(self) -> float:
        """Largest offset |x| [mm] of a column whose light can cross every curved face."""
        return min(face.aperture for face in self.faces)

    def map(self, grid: WebGrid | None = None) -> WrapMap:
        """The map between the wrapped and the flat film over the window.

        Args:
            grid: Extends the straight runs to a whole number of its voxels; None leaves them unchanged.

        Returns:
            The map.
        """
        plain = WrapMap(self.radius, self.outer, self.neutral_radius, self.leg)
        if grid is None:
            return plain
        edge = self.check(grid).edges[0]
        # A window that is already whole must not grow by rounding errors of its length.
        columns = int(np.ceil(plain.length / edge * (1.0 - 1e-12)))
        return WrapMap(self.radius, self.outer, self.neutral_radius, max(0.0, 0.5 * (columns * edge - plain.arc)))

    def coverage(self, limit: float | None = None) -> Coverage:
        """Angles from which light reaches the film, and the angles lost when the compensation is clipped.

        Args:
            limit: Largest factor of the compensation; by default the roller's own, or 2.

        Returns:
            The angles.
        """
        return coverage(self.film, self.radius, limit or self.compensation or LARGEST_GAIN, self.polarization)

    def transmittance(self, u: ArrayLike) -> Floats:
        """Power that enters the curved film from some columns of parallel light.

        Args:
            u: Offsets of the columns [mm], (...,).

        Returns:
            Share of the power, (...,); 0 for columns that miss the film.
        """
        offsets = as_offsets("u", u)
        return np.where(np.abs(offsets) < self.aperture, transmit(self.faces, offsets, self.polarization), 0.0)

    def gain(self, u: ArrayLike, limit: float | None = None) -> Floats:
        """Factors by which columns compensate Fresnel's loss: 1/transmittance, at most ``limit``.

        Args:
            u: Offsets of the columns [mm], (...,).
            limit: Largest factor; by default the roller's own, or 2.

        Returns:
            Factors, (...,).
        """
        most = limit or self.compensation or LARGEST_GAIN
        return 1.0 / np.maximum(self.transmittance(u), 1.0 / most)

    def beam(self, pitch: float, rows: int) -> Beam:
        """The widest beam whose columns all meet the film.

        Args:
            pitch: Pitch of its pixels [mm].
            rows: How many rows it has.

        Returns:
            The beam.
        """
        reach = 2.0 * min(self.aperture, self.outer) / positive("pitch [mm]", pitch)
        return Beam((max(1, ceil(reach * (1.0 - 1e-12))), rows), pitch)

    def check(self, grid: WebGrid) -> WebGrid:
        """Check that a grid is as thick as the film.

        Args:
            grid: The grid.

        Returns:
            The grid.

        Raises:
            BadInput: The thicknesses differ.
        """
        thick = grid.size[1]
        if abs(thick - self.film.thickness) > SAME * self.film.thickness:
            raise BadInput(
                f"the grid is {thick:.6g} mm thick, {grid.shape[1]} voxels of {grid.edges[1]:.6g} mm, and the film "
                f"{self.film.thickness:.6g} mm; expected the same; a pitch of "
                f"{self.film.thickness / grid.shape[1]:.6g} mm along rho makes it so"
            )
        return grid

    def trace(
        self, u: ArrayLike, angle: ArrayLike = 0.0, leg: float | None = None, device: str | Device | None = None
    ) -> Traced:
        """Trace rays of some columns. An inclined ray is rotated about the point where its column is in focus.

        Args:
            u: Offsets of the columns [mm], (...,).
            angle: Inclination towards +x in the bath [rad], (...,), broadcast with ``u``.
            leg: Length of each straight run [mm]; by default the roller's.
            device: Device that marches rays through a field of the index; a name or a device, by default the best one.

        Returns:
            The rays, flattened.
        """
        x, lean = (a.ravel() for a in np.broadcast_arrays(as_offsets("u", u), as_offsets("angle", angle)))
        middle = self.radius + 0.5 * self.film.thickness
        y = -np.sqrt(np.maximum(middle**2 - x**2, 0.0))
        if self.planes is not None:
            planes = np.array(self.planes)
            y = planes[np.searchsorted(0.5 * (planes[1:] + planes[:-1]), y, side="left")]
        return trace(self._layers(self.leg if leg is None else leg), x, y, np.sin(lean), np.cos(lean), device)

    def propagation(self, grid: WebGrid, beam: Beam, device: str | Device | None = None) -> Propagation:
        """Light of one angle in the flat film.

        Every column is ``rays`` × ``fan`` rays of equal power; in every voxel, each ray leaves exactly the energy that
        is absorbed between its entry and exit. Per flat volume, the entries are energies and include the Jacobian
        r/(r_i + τ/2): a voxel of the flat film absorbs the same as its bent counterpart. The sum over a column is the
        mean over its rays of T·(1 − exp(−α·L)), times its gain if the roller compensates. They are for a film at rest
        at its angle; its motion while it is lit is stored separately.

        Args:
            grid: Voxels of the film.
            beam: Pixels of the light.
            device: As for `trace`.

        Returns:
            The sparse matrix P[r, rho, l].

        Raises:
            BadInput: The grid is not as thick as the film, or a column misses it.
            RayError: A column is reflected totally.
        """
        map, columns = self.map(grid), self._columns(beam)
        offsets, leans = self._bundle(beam.pitch)
        segments = self.trace(columns[:, None, None] + offsets[:, None], leans, map.leg, device).segments
        shape = (columns.size, grid.shape[1], round(map.length / grid.edges[0]))
        rays = offsets.size * leans.size
        *entries, weight = cells(map, segments, segments.ray // rays, self.film.absorption, shape,
                                 (grid.edges[1], grid.edges[0]))  # fmt: skip
        r, rho, l = (index.astype(np.int32) for index in entries)  # noqa: E741 - the web's axis
        weight = weight * self._power(beam, rays)[r] * self._dense(map, grid, rho, l)
        return Propagation(shape, r, rho, l, weight, map.middle, self.lit_share * self.advance / grid.edges[0])

    def _power(self, beam: Beam, rays: int) -> Floats:
        """Power of one of ``rays`` rays of each column."""
        columns = self._columns(beam)
        return (np.ones(columns.size) if self.compensation is None else self.gain(columns)) / rays

    def _dense(self, map: WrapMap, grid: WebGrid, rho: np.ndarray, l: np.ndarray) -> Floats | float:  # noqa: E741
        """Factor from the energy of voxels to the energy per `volume`."""
        if self.volume == "flat":
            return 1.0
        return 1.0 / map.jacobian((l + 0.5) * grid.edges[0], (rho + 0.5) * grid.edges[1])

    def _bundle(self, pitch: float) -> tuple[Floats, Floats]:
        """Offsets [mm] and angles [rad] of the rays of one column."""
        leans = np.zeros(1)
        if self.divergence > 0:
            leans = np.arcsin(centers(self.fan, 2.0 / self.fan) * np.sin(self.divergence))
        return centers(self.rays, pitch / self.rays), leans

    def _columns(self, beam: Beam) -> Floats:
        columns = beam.columns()
        reach, widest = min(self.aperture, self.outer), float(np.max(np.abs(columns)))
        if widest < reach:
            return columns
        lost = int(np.count_nonzero(np.abs(columns) >= reach))
        fits = self.beam(beam.pitch, 1).pixels[0]
        if self.aperture < self.outer:
            raise RayError(
                f"{lost} of {columns.size} columns, out to {widest:.5g} mm, are totally reflected: from "
                f"index {self.film.bath_index:g} into {self.film.resin_index:g} light enters a film of "
                f"radius {self.outer:.5g} mm out to {reach:.5g} mm only; use at most {fits} columns of "
                f"{beam.pitch:g} mm, or a bath of lower index"
            )
        raise BadInput(
            f"{lost} of {columns.size} columns, out to {widest:.5g} mm, miss the film, which reaches to "
            f"{reach:.5g} mm; expected columns that meet it; use at most {fits} columns of {beam.pitch:g} mm"
        )

    def _layers(self, leg: float) -> Layers:
        film = self.film
        thick, sheet = film.substrate or (0.0, film.resin_index)
        return Layers(
            self.radius,
            self.outer,
            self.outer + thick,
            leg,
            film.resin_index,
            film.bath_index,
            sheet,
            self.reflectivity,
            self.index,
            self.polarization,
            self.core,
        )
