"""The widest window of a web: each segment is solved by primal-dual steps, given the dose of the fixed frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.pdhg import PDHG
from vamgpu.methods.state import OptimizerState, PartialProblem
from vamgpu.operators.compose import combine
from vamgpu.operators.web import WebProjection
from vamgpu.web import Propagation, WebGrid
from vamgpu.webs.layout import SegmentLayout
from vamgpu.webs.solver import SegmentLosses, Solver, Start

FIRST = 1 / 3  # share of the iterations that use two thresholds, before the window itself is maximized
BRIGHTEST = 1e12  # a limit of light that no pixel reaches
OUTSIDE = 0.78  # greatest dose outside the part for the first light, in units of the part's dose
SEEN = 1e-6  # a voxel counts if the angles still to be solved give it at least this share of its light


@dataclass(frozen=True, eq=False)
class FixedFrames:
    """The frames that are fixed before a segment is solved."""

    light: np.ndarray  # light of the frames just before the segment's own, as shown, [angles of an overlap, r, z]
    columns: tuple[int, int]  # of the segment's columns, the first that is on the web and the one after the last
    levels: tuple[float, float] | None = None  # least dose of the part and greatest outside, from the first segment


class WindowSolver:
    """Solver of segments of one shape, in order; each is solved like a part by `PDHG`; arguments as for `Solver`."""

    # A window is not a sum over voxels, and segments solved separately would not fit together: each is solved with the
    # dose of all earlier frames. The first one finds the levels that the others keep: one threshold for the whole web.

    layout: SegmentLayout
    device: Device
    method: PDHG
    step: float = 0.0

    def __init__(
        self, layout: SegmentLayout, grid: WebGrid, beam: Beam, light: Propagation, method: PDHG, device: Device
    ) -> None:
        if layout.overlap * layout.step < layout.window:
            raise BadInput(
                f"an overlap of {layout.overlap} angles is less than a window of light; expected overlap ≥ 1, "
                "because this method solves a segment with all frames that light it"
            )
        self.layout, self.device, self.method = layout, device, method
        self.thresholds: Solver = Solver(layout, grid, beam, light, LBFGS(outside=OUTSIDE), device)
        self.operator: WebProjection = self.thresholds.operator
        free = np.arange(layout.poses) >= layout.overlap
        self.free: DeviceArray = device.table(free.astype(np.float32))
        every, own = (self._lit(times) for times in (np.ones(layout.poses), free))
        endless = every[len(every) // 2]
        self.unlit: np.ndarray = np.clip(1.0 - every / np.where(endless > 0.0, endless, 1.0), 0.0, 1.0)
        self.unlit[: len(every) // 2] = 0.0  # from frames before those that a segment knows
        self.seen: np.ndarray = own > SEEN * endless
        self._light: DeviceArray | None = None

    def _lit(self, times: np.ndarray) -> np.ndarray:
        """Dose of light 1 at some poses, (l, rho, z)."""
        light = self.device.upload(np.ones(self.operator.range.shape, np.float32))
        table = self.device.table(times.astype(np.float32))
        self.device.launch(weigh_poses, light=light, times=table, weighted=light)
        return self.operator.T(light).numpy()

    def solve(
        self, fractions: np.ndarray, iterations: int, before: FixedFrames
    ) -> tuple[DeviceArray, SegmentLosses, tuple[float, float] | None]:
        """Light [pose, r, z], losses as 1 − window, and (least dose of the part, greatest outside) or None."""
        on = np.zeros(len(fractions), bool)
        on[slice(*before.columns)] = True
        judged = np.where(self.seen & on[:, None, None], fractions, -1.0).astype(np.float32)
        if not (judged >= 0.5).any():
            self._light = self.device.upload(np.zeros(self.operator.range.shape, np.float32))
            return self._light, SegmentLosses(0.0, 0.0), None
        state = OptimizerState(self.operator, self.device.upload(fractions), {})
        shown = self._rest(before)
        rest = shown + self.unlit * fractions
        state.partial = PartialProblem(
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

    def _rest(self, before: FixedFrames) -> np.ndarray:
        """Dose of the fixed frames, (l, rho, z)."""
        shown = np.zeros(self.operator.range.shape, np.float32)
        shown[: self.layout.overlap] = before.light
        return self.operator.T(self.device.upload(shown)).numpy()

    def _first(self, fractions: np.ndarray, rest: np.ndarray, iterations: int) -> DeviceArray:
        """Light by two thresholds with the existing dose, in a field of its own."""
        dark = self.device.upload(np.zeros(self.operator.range.shape, np.float32))
        decided = np.where(self.seen, rest, np.nan)
        given = Start(dark, np.zeros(self.layout.poses, bool), BRIGHTEST, self.layout.overlap, decided)
        light, _ = self.thresholds.solve(fractions, iterations, given)
        return combine(1.0, light, 0.0, light, dark)

    def buffer(self) -> DeviceArray:
        """Light [angle, r, z] of the last solved segment, dark at fixed angles."""
        assert self._light is not None
        return self._light
