"""Light for one segment of a web, by steps that do not depend on the rest of the web."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, Diverged, DivergenceWarning
from vamgpu.geometry import Beam
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.kernels.stack import put_slices
from vamgpu.kernels.update import linear
from vamgpu.losses.loss import Loss
from vamgpu.methods.bclp import BCLP
from vamgpu.methods.exposure import DoseObjective
from vamgpu.methods.method import Method
from vamgpu.methods.minimize import Channel, StepRule, minimize
from vamgpu.methods.ramp import Taps, bar, identity, ramp
from vamgpu.methods.state import OptimizerState
from vamgpu.methods.trajectory import LossTrajectory
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.web import WebProjection
from vamgpu.web import Propagation, WebGrid
from vamgpu.webs.layout import SegmentLayout

LAST = "the light of the segment is its last"  # its name in messages of divergence
TOGETHER = 1 << 26  # bytes of a field that the host makes at a time and uploads
STABLE = 4 / 3
"""Longest stable step of Nesterov's method, over the inverse of the loss's largest curvature, as momentum nears 1."""
PACE = 5 / 6  # ratio of the length of a step to the longest stable one


@dataclass(frozen=True)
class SegmentLosses:
    """Losses of a segment, its overlaps included."""

    first: float  # of the first iteration
    last: float  # of the last one
    trajectory: LossTrajectory | None = None  # of all of them; None for an empty segment


@dataclass(frozen=True, eq=False)
class Start:
    """The light and the dose from which a segment starts."""

    light: DeviceArray  # initial light, [angle, r, z] on the device
    planned: np.ndarray  # for each angle, whether that light is valid
    most: float  # greatest light of a pixel
    decided: int = 0  # number of first angles whose light is already decided, and is not part of the solution
    dose: np.ndarray | None = None  # from these and from frames before the segment, [l, rho, z]


class Solver:
    """Descent of a sum over voxels on segments of one shape; the light of a segment is its last."""

    # A position depends only on its neighborhood, never on where a segment begins: the loss is a sum over voxels, and
    # the step follows from one angle and the curvature. Selecting the best of all iterations would couple all of it.
    # Momentum is Nesterov's, whatever the method's own: half of it would need four times as many steps.

    layout: SegmentLayout  # shape of a segment
    device: Device

    def __init__(
        self, layout: SegmentLayout, grid: WebGrid, beam: Beam, light: Propagation, method: Method, device: Device
    ) -> None:
        coupled = method if isinstance(method, BCLP) and method.coupling and not method.apart(0.0).coupling else None
        self.norm: BCLP | None = coupled  # only the power of its norm couples positions of a web
        loss = local_loss(method if self.norm is None else self.norm.apart(0.0))
        self.layout, self.device = layout, device
        whole = WebGrid((layout.columns, *grid.shape[1:]), grid.pitch)
        self.operator: WebProjection = WebProjection.from_light(
            whole, light, float(layout.step), beam, device, poses=layout.poses, start=0.0
        )
        self._fields: dict[str, DeviceArray] = {}
        self._lower(loss)

    def _lower(self, loss: Loss) -> None:
        """Take descent steps for this loss."""
        self.loss: Loss = loss
        self.step: float = PACE * STABLE / (self._norm() * loss.curvature())
        self.pace: StepRule = StepRule(self.step, fixed=True)

    def settle(self, fractions: np.ndarray, columns: int, iterations: int) -> None:
        """Find the number by which a norm couples the web, from the first segment's ``columns`` on the web."""
        method, self.norm = self.norm, None
        if method is not None and method.ridge:
            _, losses = self.solve(fractions, iterations)
            self._lower(method.apart(losses.last / (columns * fractions[0].size)).band())

    def _norm(self) -> float:
        """‖A‖², from the light of one angle: no entry is negative, and a web uniform along l is the worst case."""
        light, rows = self.operator.light, self._rows_norm()
        sums = np.zeros(light.shape[:2])
        np.add.at(sums, (light.r, light.rho), light.weight)
        return rows * float(np.linalg.norm(sums, 2)) ** 2 / float(self.layout.step)

    def _rows_norm(self) -> float:
        """Factor of ‖A‖² for rows that differ from slices; 1 if each row is a slice."""
        grid, beam = self.operator.grid, self.operator.beam
        rows = RowResampler(beam.pixels[1], beam.pitch, grid.shape[2], grid.edges[2], self.device)
        if rows.same:
            return 1.0
        slices, shown = (self.device.upload(np.ones((1, 1, n))) for n in (grid.shape[2], rows.rows))
        forth, back = self.device.empty(shown.shape), self.device.empty(slices.shape)
        rows.from_slices(slices, forth)
        rows.to_slices(shown, back)
        return float(forth.numpy().max() * back.numpy().max())

    @cached_property
    def gain(self) -> float:
        """Scale of the filtered light: a bar half as thick as the film gets dose 1 on average."""
        state = OptimizerState(self.operator, self.device.upload(bar(self.operator.grid)), {})
        light, dose = self._filtered(state, 1.0), self._field("dose")
        state.expose(light, dose)
        return 1.0 / state.part_mean(dose)

    @cached_property
    def _unlit(self) -> np.ndarray:
        """Share of an endless run's light that columns near the ends of a segment lack, (l, rho, 1)."""
        assert self.gain  # then the light has only finite numbers
        light, dose = self._field("light"), self._field("dose")
        self.device.launch(linear, a=0.0, x=light, b=0.0, y=light, floor=1.0, out=light)
        self.operator.T(light, out=dose)
        middle = self.device.empty((*dose.shape[:2], 1))
        given = {"first": -(dose.shape[2] // 2), "factor": 1.0, "keep": 0, "lanes": dose}
        self.device.launch(put_slices, source=dose, **given, stack=middle)
        lit = middle.numpy()
        endless = np.broadcast_to(lit[len(lit) // 2], lit.shape)
        share = np.divide(lit, endless, out=np.ones_like(lit), where=endless > 0.0)
        return np.clip(1.0 - share, 0.0, 1.0).astype(np.float32)

    def _dark(self) -> DeviceArray:
        """``light`` = the projection of an empty web: darkness."""
        nothing = self.device.upload(np.zeros(self.operator.domain.shape, np.float32))
        self.operator(nothing, out=self._field("light"))
        return self._field("light")

    @cached_property
    def _ramp(self) -> Taps:
        return ramp(self.operator)

    def _filtered(self, state: OptimizerState, gain: float) -> DeviceArray:
        """``light`` = the target's filtered projection times a gain, never negative."""
        taps = self._ramp  # before the fields: measuring it needs two temporary fields
        projected, light = self._field("gradient"), self._field("light")
        state.project(state.target, projected)
        state.filter(projected, taps, light, floor=0.0)
        state.scale(gain, light, light)
        return light

    def solve(
        self, fractions: np.ndarray, iterations: int, given: Start | None = None
    ) -> tuple[DeviceArray, SegmentLosses]:
        """Light [angle, r, z] for fractions [l, rho, z], overwritten by the next call. Raises `Diverged`."""
        state = OptimizerState(self.operator, self.device.upload(fractions), {})
        if not fractions.any():
            return self._dark(), SegmentLosses(0.0, 0.0)
        gain, unlit = self.gain, self._unlit
        state.memory["light"] = self._filtered(state, gain)
        state.memory["ahead"] = self._field("ahead")
        if given is not None:
            self._planned(given, state.buffer("light"))
        state.scale(1.0, state.buffer("light"), state.buffer("ahead"))
        rest = self._rest(fractions, unlit, None if given is None else given.dose)
        dose, plain = self._field("dose"), identity(self.operator)
        exposure = DoseObjective(state, self.loss, self.pace, rest=rest, dose=dose, gradient=self._field("gradient"))
        losses = []
        for _, (loss, _) in zip(range(iterations), minimize(exposure, (Channel(state, plain),), self.pace)):  # noqa: B905
            losses.append(loss)
            if given is not None:
                for light in ("light", "ahead"):
                    self._possible(given, state.buffer(light))
            if LossTrajectory(losses).lost:
                raise Diverged(LossTrajectory(losses).message(LAST), None, LossTrajectory(losses).began)
        trajectory = LossTrajectory(losses)
        if trajectory.risen:
            warnings.warn(trajectory.message(LAST), DivergenceWarning, stacklevel=2)
        return state.buffer("light"), SegmentLosses(losses[0], losses[-1], trajectory)

    def _rest(self, fractions: np.ndarray, unlit: np.ndarray, given: np.ndarray | None) -> DeviceArray:
        """Dose of light beyond the segment, computed some columns at a time."""

        def bring(here: slice) -> np.ndarray:
            if given is None:
                return fractions[here] * unlit[here]
            later = np.arange(here.start, here.start + len(fractions[here]))[:, None, None] >= len(unlit) // 2
            return np.where(np.isnan(given[here]), fractions[here],
                            np.where(later, fractions[here] * unlit[here], 0.0) + given[here])  # fmt: skip

        each = max(1, TOGETHER // max(fractions[0].nbytes, 1))
        parts = (bring(slice(first, first + each)) for first in range(0, len(fractions), each))
        return self.device.gather(fractions.shape, parts)

    def _planned(self, given: Start, light: DeviceArray) -> None:
        """``light`` = that of the plan, if there is one."""
        others = self.device.table((~given.planned).astype(np.float32))
        self.device.launch(weigh_poses, light=light, times=others, weighted=light)
        combine(1.0, light, 1.0, given.light, light)
        self._possible(given, light)

    def _possible(self, given: Start, light: DeviceArray) -> None:
        """Limit light to what a pixel can show, and set it to 0 at angles that are already decided."""
        capped(light, given.most)
        if given.decided:
            free = self.device.table((np.arange(light.shape[0]) >= given.decided).astype(np.float32))
            self.device.launch(weigh_poses, light=light, times=free, weighted=light)

    def spare(self) -> DeviceArray:
        """Space for light [angle, r, z] until the next segment is solved."""
        return self._field("gradient")

    def buffer(self) -> DeviceArray:
        """Light [angle, r, z] of the last solved segment, overlaps included."""
        return self._field("light")

    def _field(self, name: str) -> DeviceArray:
        """A field that all segments share."""
        if name not in self._fields:
            shape = self.operator.domain.shape if name == "dose" else self.operator.range.shape
            self._fields[name] = self.device.empty(shape)
        return self._fields[name]


def local_loss(method: Method) -> Loss:
    """The loss of a method, a sum over voxels. Raises `BadInput` if a position depends on the whole web."""
    loss = getattr(method, "loss", None)
    if not isinstance(loss, Loss):
        raise BadInput(
            f"{method!r} scales its light by the dose of the whole web, but a web is solved segment by segment; "
            'expected "best", or a loss that is a sum over voxels, such as that of BCLP.paper_002()'
        )
    coupling = getattr(method, "coupling", "") or loss.coupling
    if coupling:
        raise BadInput(f"{method!r} cannot be solved piece by piece along a web: {coupling}")
    return loss
