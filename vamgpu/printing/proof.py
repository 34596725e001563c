"""What a simulated print turned out to be."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.metrics import Parts, Scores, SliceScores
from vamgpu.metrics.histogram import Histogram, histogram
from vamgpu.operators.projection import Projection
from vamgpu.printing.dose import absorbs
from vamgpu.printing.exposure import Exposure


class Line(NamedTuple):
    """One number of a proof, ready to be read."""

    name: str
    value: str
    meaning: str


@dataclass(frozen=True, eq=False)
class Proof:
    """A simulated print and its scores.

    operator: the projection.  frames: what was shone.  name: of the target.  target: fractions [x, y, z].  dose:
    Aᵀ(light) [x, y, z] in units of light × mm; both on the device.  scores: of the volume.  slices: of every z at the
    volume's scale and threshold.  light_efficiency: mean light of all pixels over that of a full-on one.  part_share:
    power absorbed in the part over power sent, or the mean length [mm] of rays inside it where nothing is absorbed.
    exposure: predicted times, where irradiance and critical dose were given.
    """

    operator: Projection
    frames: Any
    name: str
    target: DeviceArray
    dose: DeviceArray
    scores: Scores
    slices: SliceScores
    light_efficiency: float
    part_share: float
    exposure: Exposure | None = None

    @property
    def seconds(self) -> float | None:
        """Predicted exposure [s]."""
        return self.exposure.seconds if self.exposure else None

    @property
    def perfect(self) -> bool:
        """Whether every judged voxel is printed right."""
        return self.scores.missing == 0 and self.scores.excess == 0

    def printed(self) -> np.ndarray:
        """Boolean [x, y, z]: voxels that reach the threshold, the inscribed cylinder alone."""
        return (self.dose.numpy() >= self.scores.threshold) & self.operator.grid.cylinder()[:, :, None]

    def histogram(self, bins: int = 256) -> Histogram:
        """Voxels (out of, in) the part per bin of dose, from 0 to the greatest."""
        return histogram(Parts(self.dose, self.target), bins, top=self.scores.peak)

    def lines(self) -> tuple[Line, ...]:
        """Every score with its meaning."""
        s, w = self.scores, self.scores.windows
        share = "light sent that the part absorbs" if absorbs(self.operator) else "mean path of light inside the part"
        found = [
            Line("process window, strict", f"{w.strict:+.4f}", "least dose in the part − greatest outside, over peak"),
            Line("process window, 0.1 %", f"{w.fine:+.4f}", "0.1 % quantile in the part − 99.9 % outside"),
            Line("process window, 1 %", f"{w.trimmed:+.4f}", "1 % quantile in the part − 99 % outside"),
            Line("process window, one-sided", f"{w.one_sided:+.4f}", "least dose in the part − 99 % quantile outside"),
            Line("IoU", f"{s.iou:.5f}", "intersection over union at the best threshold"),
            Line("VER", f"{s.error_rate:.3e}", "voxels on the wrong side of that threshold"),
            Line("overlap", f"{s.overlap_rate:.3e}", "voxels outside that get at least the least dose inside"),
            Line("IPDR", f"{s.dose_range:.4f}", "range of the dose in the part, over peak"),
            Line("threshold", f"{s.threshold / (s.peak or 1.0):.4f}", "printed from this dose on, over peak"),
            Line("wrong voxels", f"{s.missing:,} + {s.excess:,}", "missing in the part + excess outside"),
            Line("judged voxels", f"{s.in_voxels:,} + {s.out_voxels:,}", "in the part + outside, in the cylinder"),
            Line("light efficiency", f"{100 * self.light_efficiency:.3g} %", "mean light of all pixels over full-on"),
            Line("share of the part", _share(self), share),
        ]
        return (*found, *(_times(self.exposure) if self.exposure else ()))

    def report(self, path: str | Path, plan: Any = None) -> Path:
        """Write one self-contained HTML page with pictures; ``plan`` adds its convergence and its papers.

        Raises `StorageError` where it cannot be written.
        """
        from vamgpu.printing.report import write_report

        return write_report(self, path, plan)


def _share(proof: Proof) -> str:
    if absorbs(proof.operator):
        return f"{100 * proof.part_share:.3g} %"
    return f"{proof.part_share:.3g} mm"


def _times(exposure: Exposure) -> tuple[Line, ...]:
    return (
        Line("exposure", f"{exposure.seconds:.3g} s", f"until the threshold is solid, at {exposure.given}"),
        Line("part complete", f"{exposure.complete:.3g} s", "until the last voxel of the part is solid"),
        Line("first excess", f"{exposure.spill:.3g} s", "until the first voxel outside is solid"),
        Line("light sent", f"{exposure.energy / 1e3:.3g} J", "until the end of the exposure"),
    )
