"""Projection between light at evenly spaced angles and volumes on rings, by a product for each angular frequency."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Turntable, Vessel, positive
from vamgpu.kernels.spectrum import gather_rings, light_rings, most_lit_first
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.polar import PolarGrid, PoseTile, tiles_of_vessel
from vamgpu.operators.ray_table import OpenAir
from vamgpu.operators.ring_table import ring_table
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.space import SinogramSpace, VolumeSpace, require_kinds
from vamgpu.operators.transforms import Passes, Place, ring_band, ring_radices, straight_passes
from vamgpu.schema.quantities import finite


def table_arguments(device: Device, entries: DeviceArray, greatest: float, tiles: np.ndarray, lit: np.ndarray,
                    mirrored: int = 0, tf32: int = 0) -> dict[str, Any]:  # fmt: skip
    """The arguments of `light_rings` and `gather_rings` for a table; see `vamgpu.kernels.spectrum`."""
    numbers = {"tiles": tiles, "lit": lit, "order": most_lit_first(tiles, lit)}
    uploaded = {name: device.table(values, "int32") for name, values in numbers.items()}
    return {"entries": entries, "greatest": greatest, **uploaded, "mirrored": mirrored, "tf32": tf32}


@final
class SpectralProjection(LinearOperator):
    """Rays of a beam through rings of voxels that a turntable turns, in air or inside a vessel at rest.

    ``A.T(sinogram)`` is the dose [angle, cell, z], ``A(volume)`` its plain transpose. ``A[i, j]`` is the light of pixel
    i's box, blurred by the beam's point spread, averaged over cell j, × pitch² / pixel pitch, as for a voxel of a box;
    multiply a volume by the ``areas`` of the grid to integrate it along rays. Refraction, absorption and the point
    spread are part of the light of one angle, and take no additional time.

    Args:
        grid: Rings of the volume, made for these angles.
        beam: Pixels, with their fill factor and point spread.
        vessel: For example a `Vial`; None for straight light.
        device: A name or a device; the best available one by default.
        square: Side [mm] of squares about the middles of the cells, over which doses are averaged instead of over
            cells; ``pitch`` above is then this side.
        faint: Share of the greatest entry of its table below which entries of the outermost columns count as zero.
        tf32: Use eleven bits of each number in products (TensorFloat-32) on devices with units for them: NVIDIA's in
            OpenCL. It has no effect on other devices.
        motion: Turntable of the grid's angles, with the lit share of its steps; None for one that is lit during the
            whole step.
        splines: Return coefficients of `vamgpu.operators.ring_splines`, which interpolate doses between cells; only
            with a square.
        tiles: Dose that the light of one angle leaves in every eight rings, in place of that of a vessel.

    Raises:
        BadInput: An argument is of another type, or no light reaches a ring.
        DeviceError: There is no such device.
    """

    domain: VolumeSpace
    range: SinogramSpace
    grid: PolarGrid
    beam: Beam
    motion: Turntable
    vessel: Vessel | None

    def __init__(
        self, grid: PolarGrid, beam: Beam, vessel: Vessel | None = None, device: str | Device | None = None, *,
        square: float | None = None, faint: float = 0.0, tf32: bool = False, splines: bool = False,
        motion: Turntable | None = None, tiles: Sequence[PoseTile] | None = None,
    ) -> None:  # fmt: skip
        require_kinds("SpectralProjection(grid, beam, …)", (grid, PolarGrid), (beam, Beam))
        if vessel is not None and not isinstance(vessel, Vessel):
            raise BadInput(f"got {vessel!r} as vessel; expected a Vial, a Vat, or None for straight light")
        if not isinstance(tf32, bool):
            raise BadInput(f"got tf32={tf32!r}; expected True for products of eleven bits, or False")
        if square is not None:
            positive("square", square)
        if not 0.0 <= finite("faint", faint) < 1.0:
            raise BadInput(f"got faint={faint}; expected a share of the greatest entry, 0 or more and below 1")
        if not isinstance(splines, bool) or (splines and square is None):
            raise BadInput(f"got splines={splines!r}, square={square}; expected splines=True with a square, or False")
        motion = Turntable(grid.angles) if motion is None else motion
        if not isinstance(motion, Turntable) or not motion.is_even or motion.angles != grid.angles:
            raise BadInput(f"got motion={motion!r}; expected a Turntable of the grid's {grid.angles} evenly spaced "
                           "angles, lit equally long, or None")  # fmt: skip
        self._given = {"square": square, "faint": faint, "tf32": tf32, "splines": splines, "motion": motion}
        self._has_tiles = tiles is not None
        self.tf32: bool = tf32
        self.grid, self.beam, self.vessel, self.motion = grid, beam, vessel, motion
        self.domain = VolumeSpace(grid)  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.range = SinogramSpace(beam, self.motion)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.device: Device = open_device(device)
        self._rows = RowResampler.of(beam, grid.slices, grid.slice_pitch, self.device)
        arc = float(motion.arcs[0])
        given = tiles or tiles_of_vessel(grid, beam, vessel or OpenAir(), square, splines, arc)
        table = ring_table(grid, beam, given, self.device, faint, splines)
        self._light_shape = (grid.angles, beam.pixels[0], grid.slices)
        held = self.device.hold(table.entries)
        self._entries = table_arguments(
            self.device, held, table.greatest, table.tiles, table.lit, int(table.mirrored), int(tf32)
        )

    def _thinned(self, slices: int) -> SpectralProjection:
        """The same operator for as many slices and rows, with the same tables."""
        other = copy(self)
        other.grid = replace(self.grid, slices=slices)
        other.beam = replace(self.beam, pixels=(self.beam.pixels[0], slices))
        other.domain, other.range = VolumeSpace(other.grid), SinogramSpace(other.beam, self.motion)  # pyright: ignore
        other._rows = RowResampler.of(other.beam, slices, self.grid.slice_pitch, self.device)
        other._light_shape = (*self._light_shape[:2], slices)
        vars(other).pop("_held", None)  # its work fields are smaller
        return other

    def described(self) -> dict[str, Any]:
        """Describe the constructor's arguments.

        Returns:
            Its arguments by name.

        Raises:
            BadInput: The operator was made from tiles.
        """
        if self._has_tiles:
            raise BadInput(f"got {self!r}, made of tiles; expected one of a vessel: pickle the operator of its tiles")
        return {"grid": self.grid, "beam": self.beam, "vessel": self.vessel, **self._given}

    def __repr__(self) -> str:
        vessel = f", {self.vessel!r}" if self.vessel else ""
        how = "" if self.motion.lit_share == 1.0 else f", motion={self.motion!r}"
        return f"SpectralProjection({self.grid!r}, {self.beam!r}{vessel}, device={self.device.name!r}{how})"

    @cached_property
    def _of_light(self) -> Passes:
        return straight_passes(self.device, *self._light_shape[:2])

    @cached_property
    def _to_rings(self) -> Passes:
        own = self._radices and [radices[::-1] for radices in self._radices]
        return Passes(self.device, [(n, rings, spectral, cells) for n, rings, cells, spectral in self._bands], own)

    @cached_property
    def _from_rings(self) -> Passes:
        return Passes(self.device, self._bands, self._radices)

    @property
    def _radices(self) -> list[tuple[int, ...]] | None:
        return ring_radices(self.device, self.grid.angles, [band.samples for band in self.grid.bands])

    @property
    def _bands(self) -> list[tuple[int, int, Place, Place]]:
        angles, width, _ = self.grid.shape
        return [ring_band(angles, band.samples, band.rings, band.cell, width) for band in self.grid.bands]

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        with self._rows.filling(out, lambda shape: self._work("rows", shape)) as rows:
            self._gather(x, rows)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._light(self._rows.in_slices(y, lambda shape: self._work("rows", shape)), out)

    def _gather(self, x: DeviceArray, rows: DeviceArray) -> None:
        """Project slices of a volume to columns, [angle, r, slice]."""
        self._in_turn(self._gathered(x), rows)

    def _gathered(self, x: DeviceArray) -> DeviceArray:
        """`_gather` for angular frequencies, in a work field."""
        launch, work = self.device.launch, self._work
        spectrum = self._from_rings.run(-1.0, x, lambda number: work(f"rings {number}", x.shape))
        light = work("light 0", self._light_shape)
        launch(gather_rings, spectrum=spectrum, **self._entries, light=light)
        return light

    def _in_turn(self, light: DeviceArray, rows: DeviceArray) -> None:
        """Transform light in "light 0" from angular frequencies to angles."""
        self._of_light.run(1.0, light, lambda number: self._work(f"light {1 - number}", self._light_shape), last=rows)

    def _light(self, rows: DeviceArray, out: DeviceArray) -> None:
        """The dose of columns in slices; the transpose of `_gather`."""
        self._on_rings(self._by_frequency(rows), out)

    def _by_frequency(self, rows: DeviceArray) -> DeviceArray:
        """Angular frequencies of light, in a work field."""
        return self._of_light.run(-1.0, rows, lambda number: self._work(f"light {number}", self._light_shape))

    def _on_rings(self, light: DeviceArray, out: DeviceArray) -> None:
        """The dose of light given by its angular frequencies."""
        spectrum = self._work("rings 0", out.shape)
        self.device.launch(light_rings, light=light, **self._entries, spectrum=spectrum)
        self._to_rings.run(1.0, spectrum, lambda number: self._work(f"rings {1 - number}", out.shape), last=out)
