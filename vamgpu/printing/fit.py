"""Frames whose pixels are chosen by the dose of all frames: direct binary search (M. Analoui, J. P. Allebach, Proc.
SPIE 1666 (1992) 96), after rounding to 8 bits, or after `TwoLevels` for 1 bit.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, OutOfMemory, PackWarning
from vamgpu.geometry import Grid
from vamgpu.kernels.flip import flip_pixels, price_flips, step_pixels
from vamgpu.kernels.update import linear
from vamgpu.methods.part import fractions_of, on_device, reach_of
from vamgpu.methods.plan import Plan
from vamgpu.methods.two_levels import TwoLevels
from vamgpu.operators.compose import combine
from vamgpu.operators.defocus import direct
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import dot, extent, total, window
from vamgpu.printing.frames import Frames

FULL_ON = (8.0, 4.0, 2.0, 1.0)
"""Irradiances of a full-on pixel to try if pixels are only flipped, relative to the mean weighted by itself. A lower
irradiance than the brightest pixel lights more pixels, but clips the light above it: a boat has its best window at 6, a
cross at 2."""
LIT = 0.1  # share of pixels that would be on at the first irradiance that is tried for two-level patterns
AHEAD = 0.01  # dose by which either side of a window should improve in the next sweep, relative to the peak
SWEEPS = 8  # rounds in which every pixel is considered; one for frames that do not improve further
TOGETHER = 3  # angles, a third of a turn apart, whose pixels are flipped together: their rays meet in few voxels
THIRDS = 3  # neighbors that light the same voxels are flipped one after another
NO_FLOOR = -1e30
MOST_ROUNDS, SPENT = 12, 0.1
"""Greatest number of rounds for 8-bit pixels, at one and a half evaluations each, and the largest share of the
evaluations of their plan."""
CHANCE = 0.05
"""Share of the greatest gain above which a pixel moves; at 0.3, pixels of the same voxels overshoot together."""
SMALL = 3e-4
"""Dose that weights these gains, over the peak: about the dose of one level of one pixel. At 3e-3, patterns of two
thresholds gain nothing, because they leave all voxels near their thresholds."""

Packed = Callable[[DeviceArray, float | None, str], Frames]
"""Frames of light, by the irradiance of a full-on pixel (None: that of `pack`) and a name of `DITHERS`."""


def check_fit(bits: int, shift: tuple[float, float]) -> None:
    """Raise `BadInput` if pixels of ``bits``, moved by ``shift``, cannot be chosen by their dose."""
    if bits == 1 and any(moved % 1 for moved in shift):
        raise BadInput(f'dither="fit" got shift={shift}; expected whole pixels: use those, 8 bits, or '
                       'dither="error-diffusion"')  # fmt: skip


def check_dose(operator: Any, target: Any, bits: int = 1) -> None:
    """Raise `BadInput` if pixels cannot be chosen by the dose that an operator makes for a target."""
    other = 'use dither="error-diffusion"'
    if bits == 1 and not isinstance(direct(operator), Projection):
        raise BadInput(f'dither="fit" got light of {operator!r}; expected that of a Projection or a RingProjection: '
                       f"{other}")  # fmt: skip
    if not isinstance(getattr(operator, "grid", None), Grid):
        raise BadInput(f'dither="fit" got light of {operator!r}; expected an operator on a Grid: {other}')
    if target is None:
        raise BadInput('dither="fit" got light without a target; expected a plan of optimize(), or target= for '
                       f"your own patterns: {other}")  # fmt: skip
    if getattr(target, "limits", None) is not None:
        raise BadInput(f'dither="fit" got {target.name!r}, whose voxels have their own limits; expected a part '
                       f"without bodies: {other}")  # fmt: skip


def rounds_of(plan: Any) -> int:
    """Rounds for the 8-bit pixels of a plan: 0 after too few evaluations, or if no dose is known."""
    known = isinstance(plan, Plan) and plan.target is not None and getattr(plan.target, "limits", None) is None
    if not known or plan.tolerances is not None or not isinstance(plan.operator.grid, Grid):
        return 0
    return min(MOST_ROUNDS, int(SPENT * plan.evaluations / 1.5))


def stepped(plan: Any, frames: Frames, packed: Callable[[DeviceArray], Frames], rounds: int) -> tuple[Any, ...]:
    """Frames of 8 bits whose dose has nearly the window of the plan."""
    # In each round some pixels move by one level if this brings voxels that miss the plan's window nearer to it; the
    # pixels are spread evenly. It uses the plan's own operator, of any type.
    A, device, asked = plan.operator, plan.sinogram.device, plan.sinogram
    fit = _Fit(A, on_device(A, plan.target), asked)
    prices = {name: device.empty(A.domain.shape) for name in ("brighter", "darker")}
    gains = {name: device.empty(asked.shape) for name in prices}
    best, step = (frames, asked, -2.0), frames.scale / (len(frames.gray.table(frames.bits)) - 1)
    for number in range(rounds + 1):
        dose = A.T(frames.irradiance(device))
        if (window := fit.window(dose)) > best[2]:
            best = (frames, asked, window)
        if number == rounds:
            break
        device.launch(price_flips, dose=dose, side=fit.side, **fit.goal, step=SMALL * fit.goal["most"], **prices)
        for name, price in prices.items():
            A(price, out=gains[name])
        gain = -min(extent(each)[0] for each in gains.values())
        if gain <= 0.0:
            break
        asked = combine(1.0, asked, 0.0, asked, device.empty(asked.shape))
        device.launch(
            step_pixels, **gains, worth=gain / CHANCE, seed=number, first=0, step=step, most=frames.scale, light=asked
        )  # fmt: skip
        frames = packed(asked)
    return best


def fitted(plan: Any, packed: Packed, scale: float | None) -> tuple[Frames, float]:
    """Frames of 1 bit whose dose has nearly the window of the plan, or a wider one."""
    A, light = direct(plan.operator), plan.sinogram
    fit = _Fit(A, fractions_of(A, plan.target), light)
    if (settled := _settled(fit, plan.operator, packed, scale)) is not None:
        frames, lit, window = replace(fit, ahead=AHEAD).flipped([settled])
    else:
        bright = dot(light, light) / total(light)
        scales = [share * bright for share in FULL_ON] if scale is None else [scale]
        frames, lit, window = fit.flipped([packed(light, full, "error-diffusion") for full in scales])
    rounded = packed(light, scale, "round")
    plain = fit.window_of(rounded)
    if plain >= window:
        warnings.warn(f"at {frames.shape[0]} angles rounding keeps a window of {plain:+.3f}, and pixels chosen by "
                      f"dose keep {window:+.3f}; the frames are rounded: use more angles, or 8 bits",
                      PackWarning, stacklevel=5)  # fmt: skip
        return rounded, plain
    return packed(lit, frames.scale, "round"), window


def _settled(fit: _Fit, operator: Any, packed: Packed, scale: float | None) -> Frames | None:
    """Frames whose patterns were driven to two levels; None if this fails, or the device lacks the memory."""
    try:
        found = _Settled(fit, TwoLevels(operator, fit.target, fit.light), packed)
        return found.best(scale) if found.levels.possible else None
    except OutOfMemory:
        return None


def _alike(frames: Frames, value: int) -> np.ndarray:
    """Light of frames whose bytes are all equal, [1, r, z]."""
    _, rows, width = frames.images.shape
    images = frames.device.upload(np.full((1, rows, width), value, np.uint8), table=True)
    return replace(frames, images=images, motion=None, packed=None).irradiance(frames.device).numpy()


@dataclass(frozen=True)
class _Settled:
    """Frames whose patterns were driven to two levels."""

    fit: _Fit
    levels: TwoLevels
    packed: Packed

    def best(self, full: float | None) -> Frames:
        """The frames with the widest window."""
        # Without ``full``, the light of a full-on pixel is doubled or halved while the window improves. It stays at or
        # below the brightest pixel of the patterns; the print then takes about as long at most.
        if full is not None:
            return self.at(full)[1]
        most = extent(self.fit.light)[1]
        first = min(total(self.fit.light) / (LIT * prod(self.fit.light.shape)), most)
        best = self.at(first)
        for way in (2.0, 0.5):
            found, factor = best, way
            while factor * first <= most and (after := self.at(factor * first))[0] > found[0]:
                found, factor = after, way * factor
            if found is not best:
                return found[1]
        return best[1]

    def at(self, full: float) -> tuple[float, Frames]:
        """The widest window with full-on pixels of an irradiance, and its frames."""
        rounded = self.packed(self.fit.light, full, "round")
        best = self.fit.window_of(rounded), rounded
        white = self.fit.A.device.upload(np.repeat(_alike(rounded, 0xFF), self.fit.light.shape[0], axis=0))
        for light in self.levels.seek(white):
            frames = self.packed(light, full, "round")
            window = self.fit.window_of(frames)
            best = (window, frames) if window > best[0] else best
        return best


@dataclass(frozen=True)
class _Fit:
    """The goal of a fit: the part, and the window of the plan's patterns or one ``ahead`` of that of the frames."""

    A: Any  # a Projection, if pixels are flipped
    target: DeviceArray
    light: DeviceArray
    ahead: float | None = None

    @cached_property
    def goal(self) -> dict[str, float]:
        """Least and most dose of the part, and the most of a void."""
        return dict(zip(("least", "leak", "most"), self.extremes(self.A.T(self.light)), strict=True))

    @cached_property
    def side(self) -> DeviceArray:
        """1 in the part, −1 in voids, 0 beyond the cylinder that counts."""
        within = self.A.grid.cylinder()[:, :, None]
        part = self.target.numpy() >= 0.5
        return self.A.device.upload(np.where(within, np.where(part, 1.0, -1.0), 0.0).astype(np.float32))

    @cached_property
    def poses(self) -> list[Projection]:
        """The projection of every group of angles."""
        groups = -(-self.A.motion.angles // TOGETHER)
        return [self.A.of_poses(range(first, self.A.motion.angles, groups)) for first in range(groups)]

    @cached_property
    def share(self) -> float:
        """Typical dose that a pixel gives a voxel that it lights: Σ A² / Σ A, from random signs of the voxels."""
        A, signs = self.poses[0], 2 * np.random.default_rng(0).integers(0, 2, self.A.grid.shape, np.int8) - 1
        lit = self.A.device.upload(np.abs(self.side.numpy()))
        shadow = A(self.A.device.upload((signs * lit.numpy()).astype(np.float32)))
        return dot(shadow, shadow) / total(A(lit))

    def window_of(self, frames: Frames) -> float:
        """Strict window of the dose of frames."""
        return self.window(self.A.T(frames.irradiance(self.A.device)))

    def window(self, dose: DeviceArray) -> float:
        """Strict window of a dose; −1 where it is dark."""
        least, leak, greatest = self.extremes(dose)
        return (least - leak) / greatest if greatest > 0.0 else -1.0

    def extremes(self, dose: DeviceArray) -> tuple[float, float, float]:
        """Least dose of the part, most of a void, 0 or more, and most of all."""
        least, leak, greatest = window(dose, self.target, reach_of(self.A.grid))
        return least, max(leak, 0.0), greatest

    def flipped(self, begun: Sequence[Frames]) -> tuple[Frames, DeviceArray, float]:
        """The pixels of some frames that gain most, their light after the flip, and its strict window."""
        orders = np.random.default_rng(0).permuted(np.tile(np.arange(len(self.poses)), (SWEEPS, 1)), axis=1)
        run = max((_Flips(self, frames).swept(orders[0]) for frames in begun), key=lambda each: each.best)
        for order in orders[1:]:
            before = run.window
            if run.swept(order).window == before:
                break
        return run.frames, run.kept, run.best


class _Flips:
    """Pixels of frames while they are flipped."""

    def __init__(self, fit: _Fit, frames: Frames) -> None:
        self.fit, self.frames, self.device = fit, frames, fit.A.device
        _, rows, columns = frames.shape
        self.black, white = (_alike(frames, value) for value in (0x00, 0xFF))
        self.step = white - self.black
        lit = frames.irradiance(self.device).numpy() > self.black + 0.5 * self.step
        third = np.add.outer(np.arange(columns), np.arange(rows)) % THIRDS
        several = [np.repeat(np.where(third == k, self.step, 0.0), TOGETHER, axis=0) for k in range(THIRDS)]
        self.steps = {
            count: [self.device.upload(each[:count].astype(np.float32)) for each in several]
            for count in {A.motion.angles for A in fit.poses}
        }
        groups = len(fit.poses)
        self.light = [
            self.device.upload((lit[group::groups] * self.step).astype(np.float32)) for group in range(groups)
        ]
        self.best = -2.0
        self._judge()

    def swept(self, order: np.ndarray) -> _Flips:
        """Consider every pixel once, by groups of angles in some order."""
        fit, launch = self.fit, self.device.launch
        prices = {name: self.device.empty(fit.A.domain.shape) for name in ("brighter", "darker")}
        usual = float(self.step[self.step > 0.0].mean()) * fit.share
        goal = fit.goal
        if fit.ahead is not None:  # slightly wider than the window of the dose
            least, leak, most = fit.extremes(self.dose)
            goal = {"least": least + fit.ahead * most, "leak": leak - fit.ahead * most, "most": most}
        for group in order:
            A, light = fit.poses[group], self.light[group]
            change = self.device.empty(light.shape)
            for step in self.steps[A.motion.angles]:
                launch(price_flips, dose=self.dose, side=fit.side, **goal, step=usual, **prices)
                gains = {name: A(price) for name, price in prices.items()}
                launch(flip_pixels, **gains, step=step, light=light, change=change)
                more = A.T(change, out=prices["darker"])
                launch(linear, a=1.0, x=self.dose, b=1.0, y=more, floor=NO_FLOOR, out=self.dose)
        self._judge()
        return self

    def _judge(self) -> None:
        """The dose of the current pixels, computed anew without accumulated changes; keep the best patterns."""
        light = np.empty(self.fit.light.shape, np.float32)
        for group, raised in enumerate(self.light):
            light[group :: len(self.light)] = self.black + raised.numpy()
        shown = self.device.upload(light)
        self.dose = self.fit.A.T(shown)
        self.window = self.fit.window(self.dose)
        if self.window > self.best:
            self.best, self.kept = self.window, shown
