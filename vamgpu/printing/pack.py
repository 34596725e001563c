"""Turn a plan's patterns into frames, on the plan's device."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, sqrt
from typing import Any, Protocol

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.deprecated import named_arguments
from vamgpu.errors import BadInput, PackWarning, ToleranceWarning
from vamgpu.geometry import Turntable, positive
from vamgpu.kernels.pack import BINS, NEVER, count_light, fold_bits, quantize
from vamgpu.methods.plan import Plan, copied
from vamgpu.methods.start import own_light
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.protocol import Operator
from vamgpu.operators.reductions import dot
from vamgpu.operators.space import require
from vamgpu.printing.black_level import no_light
from vamgpu.printing.fit import MOST_ROUNDS, check_dose, check_fit, fitted, rounds_of, stepped
from vamgpu.printing.frames import Frames, flat_table, flattened
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.placement import FIT, Placement

SPARED, HOT = 0.99999, 2.0
"""Quantile of the lit pixels, and the default limit of a pixel's brightness relative to it."""
ROUNDS = (21, 11, 1)
"""Bits that each round of the search for a quantile resolves: ten a round, from the sign of a float32 down."""
FEW = 120
"""Angles up to which 1-bit error diffusion is compared with rounding. Measured on a disk, a bar and a random plane: up
to 12 angles, rounding can give the better dose; from 16 angles on, diffusion always did."""
FAINTEST, BRIGHTEST = 1e-30, 1e30
"""Range of the light of a full-on pixel within which float32 divides by it without loss."""


class Patterns(Protocol):
    """A plan, or any object with patterns and the operator that makes dose from them."""

    @property
    def sinogram(self) -> DeviceArray: ...

    @property
    def operator(self) -> LinearOperator | Operator | None: ...


@dataclass(frozen=True, eq=False)
class Solved:
    """Patterns, the operator that makes dose from them, and their target if it is known."""

    sinogram: DeviceArray
    operator: LinearOperator | Operator | None
    target: Any = None


@named_arguments("bits", "gray", "flat_field", "flip_r", "flip_z", "shift", "quantile", "dither", "scale")
def pack(
    plan: Patterns | Operator,
    light: Any = None,
    *,
    target: Any = None,
    bits: int = 8,
    gray: GrayCurve | None = None,
    flat_field: Any = None,
    flip_r: bool = False,
    flip_z: bool = False,
    shift: tuple[float, float] = (0.0, 0.0),
    quantile: float | None = None,
    dither: str | None = None,
    scale: float | None = None,
) -> Frames:
    """Frames of 8 or 1 bits that show the patterns of a plan, or your own, as exactly as the projector can.

    ``pack(plan)`` packs a plan, ``pack(A, light)`` your own patterns. Everything runs on the plan's device, or the
    operator's.

    Args:
        plan: A plan, or any object with its ``sinogram`` and ``operator``; or, with ``light``, the operator that makes
            dose from it.
        light: Your own patterns [angle, r, z] ≥ 0, an array of any library (NumPy, PyTorch, JAX, CuPy); it is copied.
        target: Target of your own patterns, as for `optimize`: "fit" and ``vam prove`` need it.
        bits: Bits per pixel, 8 or 1.
        gray: Light of the levels, by default proportional without a black level.
        flat_field: Relative brightness [row, column] of full-on mirrors, compensated up to full-on.
        flip_r, flip_z: Whether columns and rows are mirrored.
        shift: Columns and rows [pixels] by which frames are moved; light shifted over an edge is lost.
        quantile: Quantile of the lit pixels that a full-on pixel shows; at least one of the plan's pixels shows it, and
            brighter ones are clipped to it. 1 clips none. None shows the brightest pixel, or twice the quantile 0.99999
            if that is less; an outlier then does not dim the print. Not used with ``scale``.
        dither: "round" to the nearest level, or "error-diffusion", which adds a pixel's error to the next angle in the
            order of the scan, for angles of equal dwell. Frames of 1 bit at `FEW` angles or fewer are rounded instead,
            with a `PackWarning`, if the rounded dose is closer to that of the patterns, up to a factor. "fit" chooses
            each pixel by the dose of all pixels. For 8 bits, some pixels move up or down by one level if that restores
            the window of the plan, in up to twelve rounds of one and a half evaluations each. For 1 bit it returns the
            widest window found, and the brightness of a full-on pixel if neither ``quantile`` nor ``scale`` sets it; it
            needs a plan of a vial, moved by whole pixels. The ``plan`` of the frames then has the unrounded patterns
            and the window of the frames. None chooses, for 1 bit, "fit" if possible, otherwise "error-diffusion", or
            "round" for angles of unequal dwell. For 8 bits it chooses "fit", limited to a tenth of the plan's
            evaluations, if the plan has no bodies and no tolerances, otherwise "round".
        scale: Irradiance of a full-on pixel, instead of the quantile.

    Returns:
        The frames, on the plan's device.

    Raises:
        BadInput: A value is out of its range, or your own patterns are negative or not finite.
        ShapeMismatch: The flat field does not fit the beam, or your own patterns or their target do not fit the
            operator.
        NoLight: The patterns are dark everywhere.
    """
    if isinstance(bits, bool) or bits not in (1, 8):
        raise BadInput(f"bits is {bits!r}; expected 1 or 8")
    known = light is not None or isinstance(plan, Plan)  # whether the dose of all the light is known
    plan = _patterns(plan, light, target)
    light = _light(plan)
    rounds = rounds_of(plan) if dither is None and bits == 8 else MOST_ROUNDS
    if dither is None:
        dither = _best_bits(plan, shift, known) if bits == 1 else FIT if rounds else "round"
    settings = Placement(flip_r, flip_z, shift, None if scale is not None else quantile, dither)
    curve = GrayCurve.linear() if gray is None else gray
    if not isinstance(curve, GrayCurve):
        raise BadInput(f"gray is {gray!r}; expected a GrayCurve, such as GrayCurve.gamma(2.2)")
    motion = getattr(getattr(plan, "operator", None), "motion", None)
    motion = motion if isinstance(motion, Turntable) else None
    check_dither(dither, getattr(plan, "operator", None), getattr(plan, "target", None), bits, settings.shift)
    angles, columns, rows = light.shape
    flat = None if flat_field is None else flattened(flat_field, (rows, columns))
    shared = {"sinogram": light, "flat": flat_table(light.device, flat), **settings.arguments()}
    again = _packing(bits, curve, flat, settings)
    if dither == FIT and bits == 1:
        shown = _quantile(plan, settings, shared)  # explains why there is no light
        return _fitted(plan, again, settings, shown if scale is None and quantile is not None else scale)
    full = _full(positive("scale", scale) if scale is not None else _quantile(plan, settings, shared))
    carry = float(np.diff(curve.table(bits)).max()) if dither == "error-diffusion" else 0.0
    images = _quantized(curve.table(bits), bits, full, carry, shared)
    kept = replace(plan, state={}) if isinstance(plan, Plan) else plan  # a run's memory is several times the light
    frames = Frames(images, bits, curve, full, columns, settings, flat, motion, (images, kept))
    if dither == FIT:
        found, asked, window = stepped(plan, frames, lambda asked: again(asked, full, "round"), rounds)
        shown = _showing(plan, asked, window)
        return replace(found, settings=settings, motion=motion, packed=(found.images, shown))
    if carry == 0.0 or bits == 8 or angles > FEW or getattr(plan, "operator", None) is None:
        return frames
    plain = again(plan, full, "round")
    return _better(plan, frames, replace(plain, settings=replace(settings, dither="round")))


def _full(full: float) -> float:
    """The light of a full-on pixel, checked to be in the range in which float32 can divide by it. Raises `BadInput`."""
    if not FAINTEST <= full <= BRIGHTEST:
        raise BadInput(
            f"a full-on pixel is {full:.3g}; expected {FAINTEST:g} to {BRIGHTEST:g}, within which float32 divides: "
            "scale the plan's light"
        )
    return full


def _quantized(steps: np.ndarray, bits: int, full: float, carry: float, shared: dict[str, Any]) -> DeviceArray:
    """Levels of light, rounded to the nearest of ``steps``, on the light's device."""
    device, (angles, columns, rows) = shared["sinogram"].device, shared["sinogram"].shape
    bounds = np.append(0.5 * (steps[1:] + steps[:-1]), np.full(257 - steps.size, NEVER))
    images = device.empty((angles, rows, columns), np.uint8, table=True)
    tables = {"curve": device.table(steps), "bounds": device.table(bounds)}
    device.launch(quantize, **tables, gain=1.0 / full, carry=carry, images=images, **shared)
    if bits == 8:
        return images
    folded = device.empty((angles, rows, -(-columns // 8)), np.uint8, table=True)
    device.launch(fold_bits, images=images, folded=folded)
    return folded


def _packing(bits: int, gray: GrayCurve, flat: np.ndarray | None, place: Placement) -> Callable[..., Frames]:
    """A function that packs other patterns, or a plan, in the same way, each with its own full-on pixel and dither."""

    def packed(light: Patterns | DeviceArray, full: float | None, dither: str) -> Frames:
        return pack(
            Solved(light, None) if isinstance(light, DeviceArray) else light, bits=bits, gray=gray, flat_field=flat,
            flip_r=place.flip_r, flip_z=place.flip_z, shift=place.shift, dither=dither, scale=full,
        )  # fmt: skip

    return packed


def _fitted(plan: Patterns, packed: Callable[..., Frames], place: Placement, scale: float | None) -> Frames:
    """Frames of 1 bit whose pixels are chosen by their dose."""
    frames, window = fitted(plan, packed, scale)
    light, motion = frames.irradiance(plan.sinogram.device), getattr(plan.operator, "motion", None)
    return replace(frames, settings=place, motion=motion, packed=(frames.images, _showing(plan, light, window)))


def _showing(plan: Any, light: DeviceArray, window: float) -> Patterns:
    """A plan of other patterns, with this strict window at the nominal corner."""
    if not isinstance(plan, Plan):
        return Solved(light, plan.operator, plan.target)
    if plan.tolerances is None:
        return replace(plan, sinogram=light, window=window, state={})
    corners = plan.tolerances.doses(plan.operator, light, plan.target)
    if corners.window <= 0.0:
        warnings.warn(f"the frames do not print at every corner of the plan's tolerances: {corners.statement()}; take "
                      "8 bits, or more angles", ToleranceWarning, stacklevel=5)  # fmt: skip
    return replace(plan, sinogram=light, window=corners.window, corners=corners, state={})


def check_dither(
    dither: str | None, operator: Any, target: Any, bits: int = 1, shift: tuple[float, float] = (0.0, 0.0)
) -> None:  # fmt: skip
    """Check the packing settings, before patterns exist."""
    motion = getattr(operator, "motion", None)
    carried = dither == "error-diffusion" or (dither == FIT and bits == 1)
    if carried and isinstance(motion, Turntable) and motion.dwell is not None:
        raise BadInput(
            f"{dither} got angles of {motion}; expected angles that are lit equally long, because each angle "
            'corrects the error of the one before: use dither="round"'
        )
    if dither == FIT:
        check_fit(bits, shift)
        check_dose(operator, target, bits)


def _best_bits(plan: Patterns, shift: tuple[float, float], known: bool) -> str:
    """The dither of 1 bit that preserves the dose best; known: whether only light is known."""
    operator, shift = plan.operator, Placement(shift=shift).shift
    for dither in (FIT, "error-diffusion") if known else ("error-diffusion",):
        try:
            check_dither(dither, operator, getattr(plan, "target", None), shift=shift)
        except BadInput:
            continue
        return dither
    return "round"


def repack(
    frames: Frames, *, gray: GrayCurve | None = None, flat_field: Any = None, shift: tuple[float, float] | None = None,
    moves: np.ndarray | None = None,
) -> Frames:  # fmt: skip
    """Pack the patterns of frames for another machine: with its gray curve, its flat field and its axis.

    The patterns are those of the plan that the frames were packed from. If the plan is unknown, the patterns are
    computed from the bytes and their settings, and nothing is corrected twice; they are rounded once more, by at most
    half the step between two levels of the new curve.

    Args:
        frames: Frames of any machine.
        gray: Light of the new machine's levels; None keeps that of the frames.
        flat_field: Relative brightness [row, column] of its full-on mirrors, of the frames' shape; None keeps that of
            the frames. All mirrors are dimmed to the dimmest one, and no light is clipped: ``scale``, the irradiance of
            a full-on mirror, grows by the same factor.
        shift: Columns and rows [pixels] by which frames are moved, in place of the frames' own shift; None keeps that.
        moves: Further columns [frame, row] by which each row of each frame is moved, for a vial with runout; None moves
            none. Fractions of a column are divided between both neighbors, as with ``shift``.

    Returns:
        Frames of the same bits, angles and flips, on the same device.

    Raises:
        BadInput: A value is out of its range.
        ShapeMismatch: The flat field does not fit the frames.
    """
    settings = frames.settings if shift is None else replace(frames.settings, shift=shift)
    flat = frames.flat_field if flat_field is None else flattened(flat_field, frames.shape[1:])
    light = frames.irradiance() if frames.plan is None else frames.plan.sinogram
    light = light if light.device is frames.device else frames.device.upload(light.numpy())
    if moves is not None:
        light = light.device.upload(_moved(light.numpy(), np.asarray(moves, np.float64), settings))
    dimmest = 1.0 if flat_field is None or flat is None else float(flat.min())
    made = pack(
        Solved(light, None), bits=frames.bits, gray=gray or frames.gray, flat_field=flat, flip_r=settings.flip_r,
        flip_z=settings.flip_z, shift=settings.shift, scale=frames.scale / dimmest, dither="round",
    )  # fmt: skip
    packed = None if frames.plan is None else (made.images, frames.plan)
    return replace(made, settings=settings, motion=frames.motion, packed=packed)


def _moved(light: np.ndarray, moves: np.ndarray, settings: Placement) -> np.ndarray:
    """Light [angle, r, z] whose rows are moved along r by columns [angle, row] of frames, with linear interpolation."""
    from scipy.ndimage import map_coordinates  # takes longer to load than all of vamgpu

    angles, columns, rows = light.shape
    if moves.shape != (angles, rows) or not np.isfinite(moves).all():
        raise BadInput(f"moves has shape {moves.shape}; expected finite columns [frame, row] of {(angles, rows)}")
    along = (moves if settings.flip_z else moves[:, ::-1]) * (-1.0 if settings.flip_r else 1.0)
    column, row = np.mgrid[:columns, :rows].astype(float)
    places = ((image, (column - far, row)) for image, far in zip(light, along, strict=True))
    return np.stack([map_coordinates(image, at, order=1, mode="grid-constant") for image, at in places])


def _better(plan: Patterns, diffused: Frames, rounded: Frames) -> Frames:
    """Frames with error diffusion, or rounded ones if their dose is better, with a `PackWarning`."""
    misses = _miss(plan, diffused), _miss(plan, rounded)
    if misses[0] <= misses[1]:
        return diffused
    warnings.warn(
        f"at {diffused.shape[0]} angles error diffusion misses the dose of the light by {100 * misses[0]:.0f} %, "
        f"rounding by {100 * misses[1]:.0f} %; the frames are rounded: use more angles, or 8 bits",
        PackWarning,
        stacklevel=4,
    )
    return rounded


def _miss(plan: Patterns, frames: Frames) -> float:
    """Sine of the angle between the frames' dose and that of the plan; 0 if they are proportional."""
    # A factor does not matter, because the exposure time compensates for it. 1 for dark frames.
    A: Any = plan.operator
    planned, shown = A.T(plan.sinogram), A.T(frames.irradiance(plan.sinogram.device))
    lengths = dot(planned, planned) * dot(shown, shown)
    return sqrt(max(0.0, 1.0 - dot(planned, shown) ** 2 / lengths)) if lengths > 0.0 else 1.0


def _patterns(plan: Any, light: Any, target: Any) -> Patterns:
    """The given plan, or own patterns with their operator. Raises `BadInput`, `ShapeMismatch`."""
    operator = hasattr(plan, "range") and hasattr(plan, "T")
    if light is None:
        if operator or hasattr(plan, "__array__"):
            raise BadInput(f"got only a {type(plan).__name__}; expected a plan of optimize(), or the operator and "
                           "light [angle, r, z]: vam.pack(A, light)")  # fmt: skip
        if target is not None:
            raise BadInput("got a target with a plan, which has its own; expected one only with an operator and light")
        return plan
    if not operator:
        raise BadInput(f"got light with a {type(plan).__name__}; expected it with the operator that makes dose from "
                       "it: vam.pack(A, light)")  # fmt: skip
    if target is not None:
        require(plan.domain, target, "the target")
    return Solved(copied(own_light(plan, light, "the light")), plan, target)


def _light(plan: Patterns) -> DeviceArray:
    light = getattr(plan, "sinogram", None)
    if not isinstance(light, DeviceArray) or len(light.shape) != 3:
        raise BadInput(f"the plan's sinogram is a {type(light).__name__}; expected a field [angle, r, z] on a device")
    operator = getattr(plan, "operator", None)
    if operator is not None:
        require(operator.range, light, "the plan's sinogram")
    return light


def ranked(shared: dict[str, Any], rank: Callable[[np.ndarray], int]) -> float:
    """Light of the pixel of a rank, exact except for the last bit of a float32."""
    device, prefix, left = shared["sinogram"].device, 0, 0
    for drop in ROUNDS:
        counter = device.table(np.zeros(BINS), "int32")
        device.launch(count_light, drop=drop, prefix=prefix, counts=counter, **shared)
        counts = counter.numpy().astype(np.int64)
        if drop == ROUNDS[0]:
            if not counts.any():
                return 0.0
            left = rank(counts)
        below = np.cumsum(counts)
        chosen = int(np.searchsorted(below, left, side="left"))
        left -= int(below[chosen] - counts[chosen])
        prefix = prefix << 10 | chosen
    return float(np.array([prefix << 1 | 1], np.uint32).view(np.float32)[0])


def _quantile(plan: Patterns, settings: Placement, shared: dict[str, Any]) -> float:
    """A quantile of the lit pixels; by default the brightest, unless it is an outlier."""

    def found(quantile: float) -> float:
        return ranked(shared, lambda counts: _rank(counts, quantile, shared))

    chosen = found(settings.quantile or 1.0)
    if not chosen:
        raise no_light(plan, settings)
    return chosen if settings.quantile else min(chosen, HOT * found(SPARED))


def _rank(counts: np.ndarray, quantile: float, shared: dict[str, Any]) -> int:
    """Rank of the lit pixel to use, where the dimmest is 1; ``counts`` are those of the first round."""
    if counts[1020:].any():
        raise BadInput(f"the plan's sinogram holds {counts[1020:].sum()} pixels that are not finite; solve it again")
    lit = int(counts.sum())
    hot = (1 + (shared["part_r"] > 0)) * (1 + (shared["part_z"] > 0))  # frame pixels that a pixel of the plan covers
    spared = max(ceil((1.0 - quantile) * lit), hot) if quantile < 1 else 0
    return max(1, lit - spared)
