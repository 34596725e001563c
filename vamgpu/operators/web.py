"""Light on a moving web: the projection of a flat film at every angle, and its transpose, the dose."""

from __future__ import annotations

from typing import final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import ShapeMismatch
from vamgpu.geometry import Beam, one_ray_a_pixel
from vamgpu.kernels.unfold import mix_poses, shift_window
from vamgpu.operators.bands import Bands
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.space import SinogramSpace, VolumeSpace, require_kinds
from vamgpu.operators.web_motion import WebMotion
from vamgpu.web import Propagation, WebGrid, Wrap, light_of_pose


@final
class WebProjection(LinearOperator):
    """The light of one angle at every position of a web that moves past it.

    ``A(web)`` is the light [angle, r, z] of a web [l, rho, z]: g[angle, r, z] = Σ over the window of P[r, rho, l]·f[l +
    start + angle·step, rho, z]; ``A.T(light)`` is the dose of the web. Columns outside the web count as 0. If a window
    begins between two columns, the film is interpolated linearly. Light is the mean over the film's motion while a
    frame is lit. The unfolded matrix of "Roll-to-roll tomographic volumetric additive manufacturing", section S2, is
    never stored: it takes the memory of f and g, and of one more g if steps are not whole columns. A pixel is that of
    the `Propagation`, without point spread.

    Args:
        grid: The web.
        beam: The beam, without ``fill`` and ``spread``.
        wrap: The machine that moves the web.
        device: A name or a device; the best available one by default.
        poses: Number of angles; by default all that light any part of the web.
        start: Start of the first window [columns]; by default the first that lights any part of the web.

    Attributes:
        light: The `Propagation` of one pose.
        motion: The `WebMotion`: poses, and step and start in columns.

    Raises:
        BadInput: An argument is of another type or out of its range.
        ShapeMismatch: The light was made for another geometry.
        SkippedColumns: Some columns are never lit.
        DeviceError: There is no such device.
    """

    domain: VolumeSpace
    range: SinogramSpace
    grid: WebGrid
    beam: Beam
    light: Propagation
    vessel: None
    motion: WebMotion
    first: float

    def __init__(
        self,
        grid: WebGrid,
        beam: Beam,
        wrap: Wrap,
        device: str | Device | None = None,
        poses: int | None = None,
        start: float | None = None,
    ) -> None:
        require_kinds("WebProjection(grid, beam, wrap, …)", (grid, WebGrid), (beam, Beam), (wrap, Wrap))
        self.wrap: Wrap | None = wrap
        self._build(
            grid, beam, light_of_pose(wrap, grid, beam, device), wrap.advance / grid.edges[0], device, poses, start
        )

    @classmethod
    def from_light(
        cls,
        grid: WebGrid,
        light: Propagation,
        step: float = 1.0,
        beam: Beam | None = None,
        device: str | Device | None = None,
        poses: int | None = None,
        start: float | None = None,
    ) -> WebProjection:
        """Build from the light of one pose.

        Args:
            grid: The web.
            light: Light of one pose.
            step: Step from angle to angle [columns].
            beam: The light's pixels; by default each row of light is a slice.
            device: A name or a device; the best available one by default.
            poses: As for `WebProjection`.
            start: As for `WebProjection` [columns].

        Returns:
            The operator, whose ``wrap`` is None.
        """
        operator = cls.__new__(cls)
        operator.wrap = None
        beam = beam or Beam((light.shape[0], grid.shape[2]), grid.edges[2])
        operator._build(grid, beam, light, step, device, poses, start)
        return operator

    def _build(
        self,
        grid: WebGrid,
        beam: Beam,
        light: Propagation,
        step: float,
        device: str | Device | None,
        poses: int | None,
        start: float | None,
    ) -> None:
        one_ray_a_pixel("WebProjection", beam)
        if light.shape[:2] != (beam.pixels[0], grid.shape[1]):
            raise ShapeMismatch(
                f"the light has {light.shape[0]} columns and {light.shape[1]} layers; expected {beam.pixels[0]} as "
                f"{beam} and {grid.shape[1]} as {grid}: build it on the same geometry"
            )
        self.grid, self.beam, self.light = grid, beam, light
        self.vessel = None
        self.motion = WebMotion.past(grid.shape[0], light.shape[2], step, poses, start)
        self.motion.check_lit(light, grid.shape[0], whole_web=poses is None and start is None)
        self.first = self.motion.start
        self.domain = VolumeSpace(grid)  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.range = SinogramSpace(beam, self.motion)  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.device: Device = open_device(device)
        self._rows = RowResampler(beam.pixels[1], beam.pitch, grid.shape[2], grid.edges[2], self.device)
        self._between = None if self.motion.whole else _Between(self.motion, light.way, self.device)
        light = light.moving if self._between is None else light
        begin, stride = (int(self.first), int(self.motion.step)) if not self._between else (self._between.first, 1)
        self._forward = Bands.forward(light, begin, stride).on(self.device)
        self._transposed = Bands.transposed(light, begin, stride).on(self.device)

    def __repr__(self) -> str:
        return f"WebProjection({self.grid!r}, {self.beam!r}, {self.motion!r}, device={self.device.name!r})"

    @property
    def nbytes(self) -> int:
        """Bytes of the tables on the device, for both directions."""
        mixed = () if self._between is None else (*self._between.mix.values(), *self._between.unmix.values())
        return sum(getattr(each, "nbytes", 0) for each in (*self._forward.values(), *self._transposed.values(), *mixed))

    def _light(self, poses: int) -> DeviceArray:
        return self.device.empty((poses, self.beam.pixels[0], self.grid.shape[2]))

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        with self._rows.filling(out) as slices:
            whole = slices if self._between is None else self._light(self._between.count)
            self.device.launch(shift_window, source=x, **self._forward, target=whole)
            if self._between is not None:
                self.device.launch(mix_poses, source=whole, **self._between.mix, target=slices)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        slices = self._rows.in_slices(y)
        if self._between is not None:
            whole = self._light(self._between.count)
            self.device.launch(mix_poses, source=slices, **self._between.unmix, target=whole)
            slices = whole
        self.device.launch(shift_window, source=slices, **self._transposed, target=out)


class _Between:
    """Angles between two columns as mixtures of ``count`` angles at whole columns from column ``first``."""

    def __init__(self, motion: WebMotion, way: float, device: Device) -> None:
        pose, column, weight = motion.taps(way)
        self.first = int(column.min())
        column -= self.first
        self.count = int(column.max()) + 1
        self.mix = _by_row(device, motion.poses, pose, column, weight)
        self.unmix = _by_row(device, self.count, column, pose, weight)


def _by_row(
    device: Device, count: int, row: np.ndarray, index: np.ndarray, share: np.ndarray
) -> dict[str, DeviceArray]:
    """The tables of `mix_poses` for entries in any order."""
    order = np.lexsort((index, row))
    rows = np.searchsorted(row[order], np.arange(count + 1))
    return {
        "rows": device.table(rows, "int32"),
        "indices": device.table(index[order], "int32"),
        "shares": device.table(share[order]),
    }
