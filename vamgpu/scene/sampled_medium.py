"""Index and absorption of a medium from arrays of samples, such as those of a CT scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable, Vessel, centers
from vamgpu.operators.medium import CoRotatingMedium
from vamgpu.operators.traced_projection import TracedProjection
from vamgpu.scene.scene import RAYS, disc_of, resin_of, through
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, Place

LIMITS = {"index": (1.0, 5.0), "absorption": (0.0, np.inf)}  # least and greatest value of each array


@dataclass(frozen=True, eq=False)
class SampledMedium:
    """Arrays of index and absorption that turn with the resin; around them is the resin of the vessel.

    Values are linear between samples and, beyond the outermost ones, fall to those of the resin within one pitch. A
    voxel gets their mean.

    Args:
        pitch: Distance of the samples [mm].
        index: Refractive indices, [x, y] or [x, y, z]; None for that of the resin everywhere.
        absorption: Absorption, natural logarithm [1/mm], [x, y] or [x, y, z]; None for that of the resin everywhere.
        center: Middle of the arrays, from the axis and the middle of the grid [mm]; 0 along z for [x, y].

    Raises:
        BadInput: An array has other axes or values beyond the limits, or there is none; or `center`
            moves arrays [x, y] along z.
    """

    pitch: Length
    index: np.ndarray | None = None
    absorption: np.ndarray | None = None
    center: tuple[Place, Place, Place] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check(self)
        if self.index is None and self.absorption is None:
            raise BadInput("SampledMedium has neither index nor absorption; expected an array of at least one")
        for name, (least, most) in LIMITS.items():
            if (given := getattr(self, name)) is None:
                continue
            values = np.asarray(given)
            if values.dtype.kind != "f" or values.ndim not in (2, 3) or not values.size:
                raise BadInput(f"SampledMedium {name} has shape {values.shape} and holds {values.dtype}; expected "
                               "floats [x, y] or [x, y, z]: first convert the gray levels of a scan")  # fmt: skip
            if wrong := values.size - np.count_nonzero(np.isfinite(values)):
                raise BadInput(f"SampledMedium {name} is NaN or infinite at {wrong} of {values.size} samples; expected "
                               "finite numbers")  # fmt: skip
            if values.min() < least or values.max() > most:
                raise BadInput(f"SampledMedium {name} runs from {values.min():g} to {values.max():g}; expected "
                               f"{least:g} to {most:g}: first convert the gray levels of a scan")  # fmt: skip
            object.__setattr__(self, name, values)
        if self.center[2] and all(each is None or np.ndim(each) < 3 for each in (self.index, self.absorption)):
            raise BadInput(f"SampledMedium center is {self.center[2]:g} mm along z, but its arrays [x, y] are the same "
                           "at every height; expected 0")  # fmt: skip

    def _on(self, grid: Grid, resin_index: float | None = None, absorption: float = 0.0) -> CoRotatingMedium:
        """The medium on the voxels of a grid, in resin that fills the grid's inscribed circle. Raises `BadInput`."""
        index, absorbs = None, np.full(grid.shape[:2], absorption)
        if self.index is not None:
            if resin_index is None:
                raise BadInput("SampledMedium has an index, but the resin has none; expected a vessel with an index")
            index = self._mean("index", self.index, grid, resin_index)
        if self.absorption is not None:
            absorbs = self._mean("absorption", self.absorption, grid, absorption)
        absorbs = (absorbs.T * disc_of(grid).T).T
        return CoRotatingMedium(index, absorbs if absorbs.any() else None, bath=None if index is None else resin_index)

    def operator(
        self, grid: Grid, beam: Beam, motion: Turntable, vessel: Vessel | None = None, *, rays: int = RAYS,
        device: str | Device | None = None,
    ) -> TracedProjection:  # fmt: skip
        """The projector of a beam through a vessel and this medium.

        Args:
            grid: Voxels.
            beam: Its pixels, without ``fill`` and ``spread``.
            motion: The turntable.
            vessel: The vessel of the resin; None for straight light.
            rays: Rays per pixel.
            device: A name or a device; the best available one by default.

        Returns:
            The projector; rays are bent at every step and traced at every angle.

        Raises:
            BadInput: No sample lies in the grid, the resin has no index, or the vessel bends light in it.
        """
        return through(self._on(grid, *resin_of(vessel)), grid, beam, motion, vessel, rays, device)

    def _mean(self, name: str, values: np.ndarray, grid: Grid, resin: float) -> np.ndarray:
        """The mean of each voxel, [x, y] or [x, y, z]."""
        found, inside = values, np.ones(())
        for axis, samples in enumerate(values.shape):
            place, size = (grid.axes()[axis] - self.center[axis]) / self.pitch, grid.pitch / self.pitch
            away = place[:, None] - centers(samples, 1.0)
            ends = np.clip([away - 0.5 * size, away + 0.5 * size], -1.0, 1.0)
            share = np.diff(ends * (1.0 - 0.5 * np.abs(ends)), axis=0)[0] / size  # integral of a hat of width 2
            if not share.any():
                raise BadInput(f"SampledMedium {name} reaches {0.5 * samples * self.pitch:.4g} mm from "
                               f"{self.center[axis]:g} mm along {'xyz'[axis]}, beyond {grid.shape[axis]} voxels of "
                               f"{grid.pitch:g} mm; expected them to meet: correct pitch or center")  # fmt: skip
            share = share.astype(np.result_type(values, np.float32))
            found = np.moveaxis(np.tensordot(share, found, (1, axis)), 0, axis)
            inside = inside[..., None] * share.sum(axis=1)
        return found + resin * np.maximum(1.0 - inside, 0.0)
