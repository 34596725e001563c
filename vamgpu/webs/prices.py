"""The widest window of a web: each segment by prices, over the dose of the frames that are decided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.methods.state import OptimizerState, Piece
from vamgpu.methods.widest import WidestWindow
from vamgpu.methods.window import ProcessWindow
from vamgpu.operators.compose import combine
from vamgpu.operators.web import WebProjection
from vamgpu.web import Propagation, WebGrid
from vamgpu.webs.layout import Layout
from vamgpu.webs.solver import Given, SegmentLosses, Solver

FIRST = 1 / 3
"""Share of the iterations that two thresholds lead, before prices do."""
BRIGHTEST = 1e12
"""Light that no pixel is held below."""
SEEN = 1e-6
"""Light of poses to be decided over that of all, from which on a voxel counts."""


@dataclass(frozen=True, eq=False)
class Decided:
    """What a segment is solved over.

    Attributes:
        light: Of the frames right before the segment's own, as they are shown, [pose of an overlap, r, z].
        columns: Of the segment's columns, the first that is on the web and the one after the last.
        levels: Least dose of the part and greatest outside that the first segment came to; None for the first.
    """

    light: np.ndarray
    columns: tuple[int, int]
    levels: tuple[float, float] | None = None


class PricedSolver:
    """Segments of one shape, in order, each as `WidestWindow` solves a part.

    A window is no sum over voxels: a place with room to spare may be lit in many ways, so that segments solved apart
    would not meet. So each is solved over the dose of all frames decided before it, as they are shown; it decides its
    core, with a window of light ahead of it, and beyond that light is taken to do its share. The dose of 1 is the
    greatest, for all. The first segment finds how far apart the least dose of the part and the greatest outside can
    be; the others need no more, so that one threshold serves all.

    Arguments as for `Solver`.
    """

    layout: Layout
    device: Device
    method: WidestWindow
    step: float = 0.0

    def __init__(
        self, layout: Layout, grid: WebGrid, beam: Beam, light: Propagation, method: WidestWindow, device: Device
    ) -> None:
        if layout.overlap * layout.step < layout.window:
            raise BadInput(
                f"an overlap of {layout.overlap} poses is less than a window of light; a method that maximizes the "
                "window solves a segment over all frames that light it: expected overlap ≥ 1"
            )
        self.layout, self.device, self.method = layout, device, method
        self.thresholds: Solver = Solver(layout, grid, beam, light, ProcessWindow(), device)
        self.operator: WebProjection = self.thresholds.operator
        free = np.arange(layout.poses) >= layout.overlap
        self.free: DeviceArray = device.table(free.astype(np.float32))
        every, own = (self._lit(times) for times in (np.ones(layout.poses), free))
        endless = every[len(every) // 2]
        self.unlit: np.ndarray = np.clip(1.0 - every / np.where(endless > 0.0, endless, 1.0), 0.0, 1.0)
        self.unlit[: len(every) // 2] = 0.0  # by frames before those that a segment knows
        self.seen: np.ndarray = own > SEEN * endless
        self._light: DeviceArray | None = None

    def _lit(self, times: np.ndarray) -> np.ndarray:
        """Dose of light 1 at some poses, (l, rho, z)."""
        light = self.device.upload(np.ones(self.operator.range.shape, np.float32))
        table = self.device.table(times.astype(np.float32))
        self.device.launch(weigh_poses, light=light, times=table, weighted=light)
        return self.operator.T(light).numpy()

    def solve(
        self, fractions: np.ndarray, iterations: int, before: Decided
    ) -> tuple[DeviceArray, SegmentLosses, tuple[float, float] | None]:
        """Light [pose, r, z] for fractions [l, rho, z] of a segment's columns, in the greatest dose's unit.

        Returns:
            The light, dark at poses that are decided; 1 − the window, first and last; least dose of the part and
            greatest outside, None where there is nothing to print.
        """
        on = np.zeros(len(fractions), bool)
        on[slice(*before.columns)] = True
        judged = np.where(self.seen & on[:, None, None], fractions, -1.0).astype(np.float32)
        if not (judged >= 0.5).any():
            self._light = self.device.upload(np.zeros(self.operator.range.shape, np.float32))
            return self._light, SegmentLosses(0.0, 0.0), None
        state = OptimizerState(self.operator, self.device.upload(fractions), {})
        shown = self._rest(before)
        rest = shown + self.unlit * fractions
        state.piece = Piece(
            self.device.upload(np.minimum(rest, 1.0).astype(np.float32)), self.device.upload(judged), self.free,
            before.levels,
        )  # fmt: skip
        warm = round(FIRST * iterations)
        state.memory["light"], losses = self._first(fractions, shown, max(1, warm)), []
        steps = self.method.steps(state)
        for number in range(iterations - warm):
            state.iteration = number
            losses.append(next(steps)[0])
        light, _, _ = state.best.choose(state)
        dose = state.volume()
        state.expose(light, dose)
        least, leak, _ = state.extremes(dose)
        self._light = light
        return light, SegmentLosses(losses[0], losses[-1]), (least, max(leak, 0.0))

    def _rest(self, before: Decided) -> np.ndarray:
        """Dose of the frames that are decided, (l, rho, z)."""
        shown = np.zeros(self.operator.range.shape, np.float32)
        shown[: self.layout.overlap] = before.light
        return self.operator.T(self.device.upload(shown)).numpy()

    def _first(self, fractions: np.ndarray, rest: np.ndarray, iterations: int) -> DeviceArray:
        """Light by two thresholds over the dose that is there, in a field of its own."""
        dark = self.device.upload(np.zeros(self.operator.range.shape, np.float32))
        decided = np.where(self.seen, rest, np.nan)
        given = Given(dark, np.zeros(self.layout.poses, bool), BRIGHTEST, self.layout.overlap, decided)
        light, _ = self.thresholds.solve(fractions, iterations, given)
        return combine(1.0, light, 0.0, light, dark)

    def buffer(self) -> DeviceArray:
        """Light [pose, r, z] of the segment solved last, dark at poses that are decided."""
        assert self._light is not None
        return self._light
