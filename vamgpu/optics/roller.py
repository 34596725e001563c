"""A roller that carries a film past the light."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput, RayError
from vamgpu.geometry import Beam, centers, positive
from vamgpu.optics.faces import Face, transmit
from vamgpu.optics.film import Film
from vamgpu.optics.inputs import Floats, as_offsets
from vamgpu.optics.interface import Polarization, polarized
from vamgpu.optics.roller_cells import cells
from vamgpu.optics.roller_coverage import Coverage, coverage
from vamgpu.optics.roller_index import FilmIndex
from vamgpu.optics.roller_rays import Layers, Traced, trace
from vamgpu.optics.wrap_map import WrapMap
from vamgpu.schema import check
from vamgpu.schema.quantities import Count, Gain, HalfAngle, Length, Share, Step, Thickness
from vamgpu.web import Propagation, WebGrid

LARGEST_GAIN = 2.0
"""Gain at which the compensation of Fresnel's loss is clipped unless told otherwise; without a limit it diverges."""
SAME = 1e-6
"""Relative difference up to which the thickness of a grid is that of the film."""


@dataclass(frozen=True)
class Roller:
    """A film wrapped by half a turn about an opaque roller, as in Toombs et al., Fig. 2; a `vamgpu.web.Wrap`.

    The axis of the roller is (0, 0). Light travels towards +y and meets the film at y = −√(r_o² − x²), refracts there
    by Snell's law with Fresnel's loss, runs straight, is absorbed by Beer and Lambert's law, and ends at the roller, in
    the bath, or at the end of one of the two legs in which the web comes and goes.

    radius: of the roller [mm].  film: what it carries.  step: turn [rad] from one pose to the next.  legs: length [mm]
    of each leg in the window; None for the depth in which light falls to 5 %.  reflectivity: of the roller, specular.
    compensation: largest gain of columns that make up for Fresnel's loss, as `gain` says; None for columns as they are.
    The gain counts as light of the beam: a projector whose columns are equally bright must show pictures times `gain`.
    divergence: half angle [rad] of the fan of light that each column is in the bath, even in its sine, about the point
    where the column meets the middle of the film.  neutral: depth of the line that bending does not stretch, in
    thicknesses from the roller.  rays, fan: rays across the width and across the fan of a column; where the walls of
    voxels run along the light, a voxel's share of a column is known to one ray.  index: of the resin where it changes
    from place to place: rays are then marched through the film; coverage, gain and aperture keep to the film's own.
    polarization: of the light: "none", "s" (its field along the roller's axis) or "p" (across it).

    Raises `BadInput`: a value out of range; `RayError`: legs left open for a film that absorbs nothing.
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

    def __post_init__(self) -> None:
        if not isinstance(self.film, Film):
            raise BadInput(f"Roller film is {self.film!r}; wanted a Film")
        if self.index is not None and not isinstance(self.index, FilmIndex):
            raise BadInput(f"Roller index is {self.index!r}; wanted a FilmIndex, or None for the film's own")
        check(self)
        polarized("Roller polarization", self.polarization)
        if self.legs is None and self.film.penetration == inf:
            raise RayError("the film absorbs nothing, so that a ray along a leg never leaves the window; "
                           "wanted the length of the legs [mm], or a film with an absorption above 0")

    @property
    def outer(self) -> float:
        """r_o [mm]: radius of the film's outer face."""
        return self.radius + self.film.thickness

    @property
    def neutral_radius(self) -> float:
        """Radius [mm] at which the film moves as fast as the flat web, r_i + τ/2 unless told otherwise."""
        return self.radius + self.neutral * self.film.thickness

    @property
    def advance(self) -> float:
        """Way [mm] of the web along its neutral line from one pose to the next."""
        return self.step * self.neutral_radius

    @property
    def leg(self) -> float:
        """Length [mm] of each leg."""
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
        """Wrapped ↔ flat over the window; with a grid its legs are drawn out to a whole number of voxels."""
        plain = WrapMap(self.radius, self.outer, self.neutral_radius, self.leg)
        if grid is None:
            return plain
        edge = self.check(grid).edges[0]
        # A window that is whole already must not grow by the rounding of its length.
        columns = int(np.ceil(plain.length / edge * (1.0 - 1e-12)))
        return WrapMap(self.radius, self.outer, self.neutral_radius, max(0.0, 0.5 * (columns * edge - plain.arc)))

    def coverage(self, limit: float | None = None) -> Coverage:
        """Angles from which light reaches the film, and what clipping the compensation at ``limit`` costs of them."""
        return coverage(self.film, self.radius, limit or self.compensation or LARGEST_GAIN, self.polarization)

    def transmittance(self, u: ArrayLike) -> Floats:
        """Power that enters the curved film from columns at offsets u [mm], parallel light; 0 where it misses."""
        offsets = as_offsets("u", u)
        return np.where(np.abs(offsets) < self.aperture, transmit(self.faces, offsets, self.polarization), 0.0)

    def gain(self, u: ArrayLike, limit: float | None = None) -> Floats:
        """What columns at offsets u [mm] are multiplied by against Fresnel's loss: 1/T, at most ``limit``."""
        most = limit or self.compensation or LARGEST_GAIN
        return 1.0 / np.maximum(self.transmittance(u), 1.0 / most)

    def beam(self, pitch: float, rows: int) -> Beam:
        """The widest beam of this pixel pitch [mm] whose columns all meet the film."""
        reach = 2.0 * min(self.aperture, self.outer) / positive("pitch [mm]", pitch)
        return Beam((max(1, ceil(reach * (1.0 - 1e-12))), rows), pitch)

    def check(self, grid: WebGrid) -> WebGrid:
        """The grid, if it is as thick as the film, else `BadInput`."""
        thick = grid.size[1]
        if abs(thick - self.film.thickness) > SAME * self.film.thickness:
            raise BadInput(f"the grid is {thick:.6g} mm thick, {grid.shape[1]} voxels of {grid.edges[1]:.6g} mm, and "
                           f"the film {self.film.thickness:.6g} mm; wanted the same; a pitch of "
                           f"{self.film.thickness / grid.shape[1]:.6g} mm along rho makes it so")
        return grid

    def trace(self, u: ArrayLike, angle: ArrayLike = 0.0, leg: float | None = None) -> Traced:
        """Rays of the columns at offsets u [mm], flattened, that lean by ``angle`` [rad] towards +x in the bath.

        A ray that leans does so about the point at which the column, unrefracted, meets the middle of the film.
        """
        x, lean = (a.ravel() for a in np.broadcast_arrays(as_offsets("u", u), as_offsets("angle", angle)))
        middle = self.radius + 0.5 * self.film.thickness
        y = -np.sqrt(np.maximum(middle**2 - x**2, 0.0))
        return trace(self._layers(self.leg if leg is None else leg), x, y, np.sin(lean), np.cos(lean))

    def propagation(self, grid: WebGrid, beam: Beam) -> Propagation:
        """Light of one pose in the flat film, `vamgpu.web.Propagation`.

        Every column is ``rays`` × ``fan`` rays of equal power; each leaves in every voxel it crosses exactly what is
        absorbed between the two walls. The entries are energies, so that the Jacobian r/(r_i + τ/2) is in them: what
        a voxel of the flat film absorbs is what its bent self absorbs, and the sum over a column is the mean over its
        rays of T·(1 − exp(−α·L)), times its gain where the roller compensates.

        Raises `BadInput`: the grid is not as thick as the film, or a column misses it; `RayError`: a column is
        reflected totally.
        """
        map = self.map(grid)
        columns = self._columns(beam)
        offsets, leans = self._bundle(beam.pitch)
        traced = self.trace(columns[:, None, None] + offsets[:, None], leans, map.leg)
        n_rho, n_l = grid.shape[1], round(map.length / grid.edges[0])
        shape, per_column = (columns.size, n_rho, n_l), offsets.size * leans.size
        *entries, weight = cells(map, traced.segments, traced.segments.ray // per_column, self.film.absorption, shape,
                                 (grid.edges[1], grid.edges[0]))  # fmt: skip
        gain = np.ones(columns.size) if self.compensation is None else self.gain(columns)
        r, rho, l = (index.astype(np.int32) for index in entries)  # noqa: E741 - the web's axis
        return Propagation(shape, r, rho, l, weight * (gain / per_column)[r], map.middle)

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
            raise RayError(f"{lost} of {columns.size} columns, out to {widest:.5g} mm, are totally reflected: from "
                           f"index {self.film.bath_index:g} into {self.film.resin_index:g} light enters a film of "
                           f"radius {self.outer:.5g} mm out to {reach:.5g} mm only; take at most {fits} columns of "
                           f"{beam.pitch:g} mm, or a bath of lower index")
        raise BadInput(f"{lost} of {columns.size} columns, out to {widest:.5g} mm, miss the film, which reaches to "
                       f"{reach:.5g} mm; wanted columns that meet it; take at most {fits} columns of {beam.pitch:g} mm")

    def _layers(self, leg: float) -> Layers:
        film = self.film
        thick, sheet = film.substrate or (0.0, film.resin_index)
        return Layers(self.radius, self.outer, self.outer + thick, leg, film.resin_index, film.bath_index, sheet,
                      self.reflectivity, self.index, self.polarization)
