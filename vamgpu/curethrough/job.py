"""Model or correction of a stack of slices, in one pass from the last slice to the first."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.curethrough.buffers import SliceBuffers
from vamgpu.curethrough.correction import Correction, Corrector
from vamgpu.curethrough.dose import Judge, RunningDose, Stack, blocks, lent
from vamgpu.curethrough.leastsquares import StageProgress, better_columns
from vamgpu.curethrough.names import following
from vamgpu.curethrough.output import check_place, writing
from vamgpu.curethrough.printer import Machine
from vamgpu.curethrough.score import Features, Sample, features, ratio, sample
from vamgpu.errors import SliceWarning
from vamgpu.kernels.curethrough import BITS
from vamgpu.reports.line import length

GRAY_PER_DOSE = 51  # number of gray levels per critical dose in pictures of the dose: white is five critical doses
LACKING = 0.1
"""Share of a slice height; a feature is incomplete, or a column prints incorrectly, if more than this is wrong."""


@dataclass(frozen=True, eq=False)
class Heights:
    """Height [mm] of the cured void and of the uncured part at every pixel [y, x]."""

    over: np.ndarray
    under: np.ndarray

    @property
    def error(self) -> float:
        """All heights that are wrong, summed over the pixels [mm]."""
        return float(self.over.sum(dtype=np.float64) + self.under.sum(dtype=np.float64))


@dataclass(frozen=True, eq=False)
class PrintedStack:
    """The print of a stack: heights of the whole, and the followed columns."""

    heights: Heights
    levels: np.ndarray  # uint8 [slice, column] of the sample as shown
    features: Features  # of the sample's columns


@dataclass(frozen=True, eq=False)
class Outcome:
    """A modeled stack, and its correction if there is one.

    Args:
        machine: Printer and resin.
        shape: Slices, y and x of the part.
        threshold: Least gray level of a solid pixel.
        sample: Columns that are followed.
        solid: Expected state of these columns, bool [slice, column].
        before: The print of the uncorrected slices.
        after: The print of the corrected slices.
        correction: The correction.
        missed: Features that get too little dose at their back, summed over pixels [slice].
        closed: Voids that stay cured, summed over pixels [slice].
        written: Slices that were written.
    """

    machine: Machine
    shape: tuple[int, int, int]
    threshold: int
    sample: Sample
    solid: np.ndarray
    before: PrintedStack
    after: PrintedStack | None = None
    correction: Correction | None = None
    missed: np.ndarray | None = None
    closed: np.ndarray | None = None
    written: int = 0

    def __repr__(self) -> str:
        return f"Outcome({' × '.join(map(str, self.shape))} slices, y, x: {self.verdict[1]})"

    @property
    def verdict(self) -> tuple[bool, str]:
        """Whether everything prints correctly, and a sentence or two on what does not."""
        heights = (self.after or self.before).heights
        errors = heights.over + heights.under
        errors = errors[errors > LACKING * self.machine.slice_height]
        wrong, mean = errors.size, length(float(errors.mean()) if errors.size else 0.0)
        said = f"{wrong:,} columns of pixels print incorrectly, by {mean} of height on average."
        if self.after is None:
            return wrong == 0, said
        before, after = self.before.heights.error, self.after.heights.error
        missed, closed = (0 if found is None else int(found.sum()) for found in (self.missed, self.closed))
        if after > before:
            text = f"The correction raises height errors from {length(before)} to {length(after)}: print without it."
        elif before == 0:
            return True, "The slices print correctly without a correction."
        else:
            text = f"The correction leaves {100 * after / before:.2g} % of the height errors."
        text += f" {said}" if wrong else ""
        if missed:
            text += f" {missed:,} features have too little space behind them for the light that they need."
        if closed:
            text += f" {closed:,} voids are too short: they stay cured at this speed and power."
        return missed + closed + wrong == 0 and after <= before, text

    @property
    def ratio(self) -> float | None:
        """Height errors of the whole print, corrected over uncorrected; None without a correction."""
        if self.after is None or self.before.heights.error <= 0:
            return None
        return self.after.heights.error / self.before.heights.error

    @property
    def feature_ratio(self) -> tuple[float, float] | None:
        """Height errors of the followed features, corrected over uncorrected: together, and the median."""
        return None if self.after is None else ratio(self.before.features, self.after.features)


def model(
    machine: Machine, stack: Stack, *, threshold: int = 128, doses: str | Path | None = None,
    device: str | Device | None = None, overwrite: bool = False, record: Mapping[str, Any] | None = None,
    progress: StageProgress = lambda stage, share: None,
) -> Outcome:  # fmt: skip
    """Simulate the print of slices as they are.

    Args:
        machine: Printer and resin.
        stack: The slices.
        threshold: Gray level from which a pixel is solid.
        doses: A folder or zip for images of the dose, 51 gray levels a critical dose.
        device: Device, or its name; None takes the best one.
        overwrite: Replace existing doses.
        record: Facts to store beside the doses.
        progress: Called with the stage and the share of it that is done.

    Returns:
        The modeled stack.

    Raises:
        BadInput: A value is out of range.
        SliceError: A slice cannot be read.
        StorageError: The doses cannot be written.
    """
    warn_of(machine)
    place = open_device(device)
    follow = _Follow(machine, stack, threshold, place)
    if doses is None:
        for start, stop in blocks(stack.shape[0]):
            follow[start:stop]
            progress("model", 1.0 - start / stack.shape[0])
    else:
        names = getattr(stack, "names", tuple(f"dose_{k:05d}.png" for k in range(stack.shape[0])))
        text = {"gray levels a critical dose": GRAY_PER_DOSE, "machine": asdict(machine), **(record or {})}
        with writing(doses, names, source=stack, overwrite=overwrite, record=text) as writer:
            exposure = RunningDose(machine, follow.shape[1:], place)
            for start, stop in blocks(stack.shape[0]):
                found = exposure.step(follow[start:stop]).numpy()
                writer.write(start, np.minimum(np.rint(GRAY_PER_DOSE * found), 255.0).astype(np.uint8))
                progress("model", 1.0 - start / stack.shape[0])
    return Outcome(machine, follow.shape, threshold, follow.sample, follow.solid, follow.shown())


def correct_stack(
    correction: Correction, stack: Stack, out: str | Path | None = None, *, device: str | Device | None = None,
    whole_columns: bool = False, overwrite: bool = False, record: Mapping[str, Any] | None = None,
    progress: StageProgress = lambda stage, share: None,
) -> Outcome:  # fmt: skip
    """Correct a stack, and score it before and after from the bytes that are written to ``out``.

    Args:
        correction: What to correct for, and how.
        stack: The slices.
        out: A folder or zip for slices with the same names, whose numbers continue for the tail; None writes nothing.
        device: Device, or its name; None takes the best one.
        whole_columns: If features or voids cannot be printed, optimize the whole column by least squares; reads the
            stack three times.
        overwrite: Replace existing files at ``out``.
        record: Facts to store with the slices.
        progress: Called with the stage and the share of it that is done.

    Returns:
        The stack before and after.

    Raises:
        BadInput: A value is out of range.
        SliceError: A slice cannot be read.
        StorageError: The slices cannot be written; a run that fails leaves nothing.
    """
    machine = correction.machine
    warn_of(machine)
    place = open_device(device)
    if out is not None:
        check_place(out, stack, overwrite=overwrite)
    better = better_columns(correction, stack, place, progress) if whole_columns else None
    follow = _Follow(machine, stack, correction.threshold, place)
    corrector = Corrector(correction, follow.shape, place)
    after, levels, buffers = Judge(machine, follow.shape[1:], place), [], SliceBuffers()

    def run(write: Callable[[int, np.ndarray], None]) -> None:
        for block in corrector.run(follow):
            pictures, table = place.download(block.table, buffers.take(block.table.shape)), block.table
            if better is not None:
                rows, columns, better_levels = better
                pictures[:, rows, columns] = better_levels[block.start : block.start + len(pictures)]
                table = lent(place, pictures, follow.shape[1:])
            after.add(table, block.words, block.start // BITS)
            place.synchronize()  # the pictures' memory may be borrowed
            levels.append(follow.sample.of(pictures))
            write(block.start, pictures)
            progress("correct", 1.0 - block.start / corrector.slices)

    written = 0
    if out is None:
        run(lambda start, pictures: None)
    else:
        own = getattr(stack, "names", tuple(f"slice_{k:05d}.png" for k in range(stack.shape[0])))
        names = own + following(own[-1], corrector.slices - len(own), own)
        text = {"machine": asdict(machine), "added slices": len(names) - len(own), **(record or {})}
        with writing(out, names, source=stack, overwrite=overwrite, record=text) as writer:
            run(writer.write)
        written = writer.written
    shown = np.concatenate(levels[::-1])
    found = PrintedStack(Heights(after.over(), after.under()), shown, features(machine, shown, follow.solid))
    flaws = (corrector.missed, corrector.closed)
    return Outcome(machine, follow.shape, correction.threshold, follow.sample, follow.solid, follow.shown(), found,
                   correction, *flaws, written)  # fmt: skip


class _Follow:
    """A stack that is judged unchanged while it passes to its reader, last block first."""

    def __init__(self, machine: Machine, stack: Stack, threshold: int, device: Device) -> None:
        self._machine, self._stack, self._threshold = machine, stack, threshold
        self.shape: tuple[int, int, int] = tuple(stack.shape)  # type: ignore[assignment]
        self.sample = sample(stack, threshold)
        self._judge = Judge(machine, self.shape[1:], device)
        self._levels = np.zeros((self.shape[0], len(self.sample.rows)), np.uint8)

    def __getitem__(self, key: slice, /) -> np.ndarray:
        block = self._stack[key]
        if len(block):
            self._judge.step(block, block, self._threshold)
            self._levels[key] = self.sample.of(block)
        return block

    @property
    def solid(self) -> np.ndarray:
        return self._levels >= self._threshold

    def shown(self) -> PrintedStack:
        """The print of the slices, after all have passed."""
        found = features(self._machine, self._levels, self.solid)
        return PrintedStack(Heights(self._judge.over(), self._judge.under()), self._levels, found)


def warn_of(machine: Machine) -> None:
    """Warn if level 0 cures all resin that it reaches: then no resin can stay uncured."""
    dose = float(machine.doses[0] / machine.decay)
    if dose >= 1.0:
        warnings.warn(
            f"even level 0 leaves {dose:.3g} critical doses behind: everything it reaches cures, nothing can stay "
            f"uncured. Print at least {dose:.3g} times faster, or darken level 0",
            SliceWarning,
            stacklevel=3,
        )
