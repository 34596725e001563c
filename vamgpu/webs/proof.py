"""Simulated print of a web, computed only from its folder, segment by segment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.cores import ahead, together
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch, StorageError
from vamgpu.geometry import Beam
from vamgpu.operators.web import WebProjection
from vamgpu.storage.reading import malformed
from vamgpu.web import Propagation, WebGrid, Wrap, light_of_pose
from vamgpu.webs.describe import wrap_from
from vamgpu.webs.drift import clouded, drifts_of, gains
from vamgpu.webs.frame_light import light_of
from vamgpu.webs.layout import SegmentLayout
from vamgpu.webs.report import page_of
from vamgpu.webs.section import lit_by
from vamgpu.webs.store import WebFolder

BINS = 2048
REACH = 4.0  # greatest counted dose, in units of the part's dose; greater ones count as this
CHUNK = 1 << 20  # number of voxels that a thread counts at a time
LEVEL = 128  # least fraction, times 255, of a voxel that belongs to the part


@dataclass(frozen=True, eq=False)
class WebPart:
    """Simulated print of the columns of one segment."""

    number: int  # of the segment
    columns: tuple[int, int]  # first and one after the last
    dose: np.ndarray  # [l, rho, z] float32
    target: np.ndarray  # boolean [l, rho, z]


@dataclass(frozen=True)
class PieceScore:
    """Scores of one segment's columns at the web's common threshold."""

    columns: tuple[int, int]  # first and one after the last
    iou: float  # intersection over union
    window: float  # strict process window, (least dose in the part − greatest outside) / greatest
    trimmed: float  # the same without a hundredth of the voxels on either side
    missing: int  # voxels on the wrong side of the threshold
    excess: int  # voxels on the wrong side of the threshold
    loss: float  # of the last iteration
    saturated: int  # pixels at full-on


@dataclass(frozen=True, eq=False)
class WebProof:
    """A simulated print of a web and its scores."""

    folder: WebFolder
    grid: WebGrid
    beam: Beam
    light: Propagation
    segments: tuple[PieceScore, ...]
    iou: float  # over the whole web, at the dose that makes iou greatest
    threshold: float  # over the whole web, at the dose that makes iou greatest
    counts: np.ndarray  # voxels by dose, (outside the part, inside) × bins
    edges: np.ndarray  # of the bins, in doses
    device: Device
    wrap: Wrap | None = None  # see `prove_web`
    gain: np.ndarray | None = None  # see `prove_web`

    @property
    def verdict(self) -> tuple[bool, str]:
        """Whether every voxel prints correctly, and a sentence."""
        missing, excess = (sum(getattr(score, name) for score in self.segments) for name in ("missing", "excess"))
        total = int(self.counts.sum())
        return missing + excess == 0, (
            f"{missing + excess:,} of {total:,} voxels print incorrectly: {missing:,} missing, {excess:,} excess."
        )

    @property
    def window(self) -> float:
        """The narrowest strict process window of any segment."""
        return min(score.window for score in self.segments)

    def pieces(self, numbers: Sequence[int] | None = None) -> Iterator[WebPart]:
        """The simulated print again, segment by segment."""
        return _Simulation(self.folder, self.device, self.wrap, self.gain).pieces(numbers)

    def report(self, path: str | Path, *, title: str = "", contrast: Sequence[tuple[float, float]] = ()) -> Path:
        """Write the HTML page; contrast: pairs of index ratio and ξ to plot. Raises `StorageError`."""
        return page_of(self, title or self.folder.path.stem, contrast).write(path)


class _Simulation:
    """Reads frames' bytes and computes their dose; has one segment in memory at a time."""

    def __init__(
        self, folder: WebFolder, device: Device, wrap: Wrap | None = None, gain: np.ndarray | None = None
    ) -> None:
        self.folder, self.device = folder, device
        with malformed(f"{str(folder.path)!r} has malformed details", "write the web again"):
            details = folder.details
            rho, z = details["grid"]["section"]
            self.beam = Beam(tuple(details["beam"]["pixels"]), details["beam"]["pitch"])
            drifts = drifts_of(details)
            if wrap is None:
                wrap = clouded(wrap_from(details["wrap"]), drifts[-1].absorption if drifts else 1.0)
            self.gain = gains(drifts, 0, folder.frames) if gain is None else gain
            window, core = (int(details["layout"][name]) for name in ("window", "core"))
            section = WebGrid((1, rho, z), tuple(details["grid"]["pitch"]))
            focus = details["frames"]["focus"]
            wrap = lit_by(wrap, 1 if focus is None else len(focus["planes"]))
        self.light = light_of_pose(wrap, section, self.beam, device)
        one = float(wrap.advance / section.edges[0])
        layout = SegmentLayout.of(self.light.shape[2], one, core * one / self.light.shape[2] * (1 - 1e-12), 1.0)
        if (layout.window, layout.core) != (window, core):
            raise StorageError(f"{str(folder.path)!r} stores light that does not match its wrap; write the web again")
        self.layout = layout
        self.grid = WebGrid((layout.columns, rho, z), section.pitch)
        self.operator = WebProjection.from_light(
            self.grid, self.light, float(layout.step), self.beam, device, poses=layout.poses, start=0.0
        )

    @property
    def finished(self) -> int:
        """Columns that were lit at all their angles."""
        folder, layout = self.folder, self.layout
        lit = int((folder.frames - layout.lead) * layout.step)
        return folder.columns if folder.complete else max(0, min(folder.columns, lit))

    def pieces(self, numbers: Sequence[int] | None) -> Iterator[WebPart]:
        for number in range(len(self.folder.segments)) if numbers is None else numbers:
            start, stop = self.layout.printed(number, self.finished)
            if start < stop:
                origin = self.layout.origin(number)
                dose = self._dose(number, start - origin, stop - origin)
                yield WebPart(number, (start, stop), dose, self.folder.read("target", start, stop) >= LEVEL)

    def _dose(self, number: int, start: int, stop: int) -> np.ndarray:
        """Dose of some columns around a segment, from the frames of all angles that reach the segment."""
        layout = self.layout
        first = number * layout.core - layout.overlap
        return self.operator.T(light_of(self.folder, first, layout.poses, self.gain, self.device)).part(start, stop)


def prove_web(
    web: WebFolder | str | Path, device: str | Device | None = None, *, wrap: Wrap | None = None,
    gain: np.ndarray | None = None, threshold: float | None = None,
) -> WebProof:  # fmt: skip
    """Simulate a web from its frames' bytes and gray curve, and score each segment against its target.

    Args:
        web: The folder, or its path. If it is not complete, only columns that were lit at all their angles are judged.
        device: A name or a device; the best available one by default.
        wrap: The machine; by default the roller that the folder describes, with the last absorption.
        gain: Light of each frame relative to the plan, (frames,); by default that of the folder's frames.
        threshold: Least dose that makes resin solid; by default that of the greatest overlap.

    Returns:
        The proof.

    Raises:
        StorageError: The folder is damaged, or its machine must be given.
        BadInput: No column is lit yet.
        ShapeMismatch: The numbers of frames and gains differ.
        DeviceError: There is no such device.
    """
    folder = web if isinstance(web, WebFolder) else WebFolder.open(web)
    if gain is not None and np.shape(gain) != (folder.frames,):
        raise ShapeMismatch(f"got gains {np.shape(gain)}; expected ({folder.frames},), one for each frame")
    simulation = _Simulation(folder, open_device(device), wrap, gain)
    edges = np.linspace(0.0, REACH, BINS + 1)
    counts, windows, spans = [], [], []
    for piece in simulation.pieces(None):
        windows.append(piece_windows(piece.dose, piece.target))  # it refuses doses that are not numbers
        counts.append(_counted(piece.dose, piece.target))
        spans.append((piece.number, piece.columns))
    if not counts:
        raise BadInput(
            f"{str(folder.path)!r} has {folder.frames} frames, and no column is lit at all angles yet; resume it"
        )
    total = np.sum(counts, axis=0)
    above = total[:, ::-1].cumsum(axis=1)[:, ::-1]
    best = int(np.argmax(above[1] / np.maximum(1, total[1].sum() + above[0])))
    at = best if threshold is None else int(np.clip(np.searchsorted(edges, threshold), 0, BINS - 1))
    scores: list[PieceScore] = []
    for (number, columns), count, (strict, trimmed) in zip(spans, counts, windows, strict=True):
        (_, missing, excess), record = _split(count, at), folder.segments[number]
        scores.append(PieceScore(columns, _iou(count, at), strict, trimmed, missing, excess, record.loss[1],
                                 record.saturated))  # fmt: skip
    return WebProof(
        folder, simulation.grid, simulation.beam, simulation.light, tuple(scores), _iou(total, at), float(edges[at]),
        total, edges, simulation.device, wrap, gain,
    )  # fmt: skip


def _counted(dose: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Voxels by dose, (outside the part, inside) × bins."""

    def some(rows: slice) -> np.ndarray:
        least = np.clip(dose[rows] * np.float32(BINS / REACH), 0.0, BINS - 1.0).astype(np.int32)
        return np.bincount((least + BINS * target[rows]).ravel(), minlength=2 * BINS)

    each = max(1, CHUNK // max(1, dose[0].size))
    parts = ahead(some, (slice(first, first + each) for first in range(0, len(dose), each)))
    return sum(parts, np.zeros(2 * BINS, np.int64)).reshape(2, BINS)


def _split(counts: np.ndarray, at: int) -> tuple[int, int, int]:
    """Voxels correctly printed, missing, and in excess, with the lower edge of bin ``at`` as threshold."""
    return int(counts[1, at:].sum()), int(counts[1, :at].sum()), int(counts[0, at:].sum())


def _iou(counts: np.ndarray, at: int) -> float:
    right, missing, excess = _split(counts, at)
    return right / max(1, right + missing + excess)


def piece_windows(dose: np.ndarray, part: np.ndarray) -> tuple[float, float]:
    """Strict and trimmed process window of a dose [l, rho, z] for a part, boolean [l, rho, z]; 0 without a part."""
    # Both are relative to the greatest dose. strict: least dose in the part − greatest outside. trimmed: 1 % quantile
    # in it − 99 % quantile outside. Raises `BadInput` for doses that are not finite.
    if odd := np.count_nonzero(~np.isfinite(dose)):
        raise BadInput(f"{odd} doses are NaN or infinite; expected finite numbers")
    inside, outside = ahead(lambda where: dose[where], (part, ~part))
    if not inside.size:
        return 0.0, 0.0
    (least, one_in), (greatest, one_out) = together(
        lambda: (inside.min(), np.quantile(inside, 0.01, method="lower")), lambda: _high(outside)
    )
    top = float(dose.max()) or 1.0
    return (float(least) - max(float(greatest), 0.0)) / top, float(one_in - one_out) / top


def _high(outside: np.ndarray) -> tuple[float, float]:
    return (outside.max(), np.quantile(outside, 0.99, method="higher")) if outside.size else (0.0, 0.0)
