"""Checks of messages from a planning process: frames must suit this print, and their light must be allowed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.records.state import Estimated, ImageCheck
from vamgpu.printing.frames import Frames

MOST = 64  # most parameters shown
MAPS, WIDEST = 4, 2048  # most images shown, and the longest side of one [pixels]
_JOBS: WeakKeyDictionary[Frames, float] = WeakKeyDictionary()  # light of jobs' frames
TOP = {8: 255, 1: 1}  # bits → highest level of a pixel


@dataclass(frozen=True, eq=False)
class Proposal:
    """Frames proposed by a planning process."""

    levels: tuple[np.ndarray, ...]  # [frame, row, column] of each projector: 0 to 255, or to 1 for 1 bit
    turn: int  # the first turn, or segment, that shows them
    stop: int | None = None  # the turn before which the light ends; None: no end


def proposal(told: Any) -> Proposal:
    """Read a proposal. Raises `BadInput`."""
    try:
        levels = tuple(np.concatenate(list(pieces)) for pieces in told["levels"])
        stop = told.get("stop")
        return Proposal(levels, _turn(told["turn"]), None if stop is None else _turn(stop))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BadInput(f"got no version of the frames: {error!r}; expected levels, turn and stop") from error


def _turn(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise TypeError(f"a turn is {value!r}; expected a whole number")
    return value


def frames_of(levels: Sequence[np.ndarray], jobs: Sequence[Frames]) -> tuple[Frames, ...]:
    """Levels as frames like those of the jobs. Raises `BadInput` if mirrors cannot show them."""
    if len(levels) != len(jobs):
        raise BadInput(f"got levels for {len(levels)} projectors; expected {len(jobs)}, one array for each")
    return tuple(_frames(each, job) for each, job in zip(levels, jobs, strict=True))


def _frames(levels: np.ndarray, job: Frames) -> Frames:
    if levels.shape != job.shape:
        raise BadInput(f"got levels {list(levels.shape)}; expected {list(job.shape)}, the job's frames")
    if levels.dtype.kind not in "uif":
        raise BadInput(f"got levels of {levels.dtype}; expected numbers")
    low, high, top = float(levels.min()), float(levels.max()), TOP[job.bits]
    if not 0 <= low <= high <= top:  # also rejects NaN
        raise BadInput(f"got levels from {low:g} to {high:g}; expected 0 to {top}")
    whole = (np.rint(levels) if levels.dtype.kind == "f" else levels).astype(np.uint8, copy=False)
    images = whole if job.bits == 8 else np.packbits(whole, axis=2)
    return replace(job, images=job.device.upload(images, table=True))


def relative_light(frames: Sequence[Frames], jobs: Sequence[Frames]) -> float:
    """Light of frames relative to the jobs' frames: all pixels, with the gray curve."""
    for job in jobs:
        if job not in _JOBS:  # counted once for all versions
            _JOBS[job] = _light(job)
    return sum(map(_light, frames)) / max(sum(_JOBS[job] for job in jobs), 1e-300)


def _light(frames: Frames) -> float:
    curve = np.asarray(frames.gray.table(frames.bits), np.float64).ravel()
    counts = np.zeros(256, np.int64)
    for image in frames.levels():
        counts += np.bincount(image.ravel(), minlength=256)
    return float(counts[: len(curve)] @ curve) * frames.scale


def parameters(told: Any) -> tuple[Estimated, ...]:
    """Estimated parameters for a board. Raises `BadInput`."""
    try:
        found = tuple(_estimated(*each) for each in told)
    except (TypeError, ValueError) as error:
        raise BadInput(f"got no parameters: {error}; expected name, value and error of each, and the lowest and "
                       "highest usual value if known") from error  # fmt: skip
    numbers = [(each.value, each.error, *(each.usual or ())) for each in found]
    right = all(each.error >= 0 and (each.usual is None or each.usual[0] < each.usual[1]) for each in found)
    if len(found) > MOST or not all(map(isfinite, (number for each in numbers for number in each))) or not right:
        raise BadInput(f"got parameters {found[:MOST]}; expected at most {MOST}, finite, errors of 0 or more, and "
                       "usual values in order")  # fmt: skip
    return found


def _estimated(name: Any, value: Any, error: Any, *usual: Any) -> Estimated:
    if not usual:
        return Estimated(str(name), float(value), float(error))
    low, high = usual
    return Estimated(str(name), float(value), float(error), (float(low), float(high)))


def checks(told: Any) -> tuple[ImageCheck, ...]:
    """Checks of a turn's images for a board. Raises `BadInput`."""
    try:
        found = tuple(
            ImageCheck(str(name), _turn(turn), float(value), float(limit)) for name, turn, value, limit in told
        )
    except (TypeError, ValueError) as error:
        raise BadInput(f"got no checks: {error}; expected name, turn, value and limit of each") from error
    if len(found) > MOST or not all(isfinite(each.value) and 0.0 < each.limit < inf for each in found):
        raise BadInput(f"got checks {found[:MOST]}; expected at most {MOST}, finite values, and limits above 0")
    return found


def maps(told: Any) -> dict[str, np.ndarray]:
    """Images for a board. Raises `BadInput`."""
    if not isinstance(told, Mapping) or len(told) > MAPS:
        raise BadInput(f"got no images: {type(told).__name__}; expected at most {MAPS}, by name")
    for name, image in told.items():
        shape = getattr(image, "shape", ())
        fits = len(shape) == 3 and shape[2] == 3 and 0 < min(shape) <= max(shape) <= WIDEST
        if not fits or image.dtype != np.uint8:
            raise BadInput(f"the image {str(name)[:80]!r} is not uint8 [row, column, color] of up to {WIDEST} pixels")
    return {str(name): np.asarray(image) for name, image in told.items()}
