"""The result of a simulated print."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.card import card, drawable
from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.deprecated import Renamed
from vamgpu.errors import BadInput
from vamgpu.methods.part import idle_light, lit_pixels
from vamgpu.metrics import Scores, SliceScores
from vamgpu.metrics.histogram import Histogram, above, histogram
from vamgpu.metrics.light import outside_over_inside
from vamgpu.metrics.mesh_union import joined
from vamgpu.metrics.parts import EVERYWHERE, IN, Parts
from vamgpu.metrics.thin_regions import Unjudged, unjudged
from vamgpu.operators.dose_unit import absorbs
from vamgpu.operators.projection import Projection
from vamgpu.printing.beyond_cylinder import Outer
from vamgpu.printing.bodies import BodyDose, body_doses, judged_parts
from vamgpu.printing.exposure import ExposureTimes
from vamgpu.printing.independent_exposure import FineSlab
from vamgpu.printing.judgement import Judgement, judged
from vamgpu.printing.scattered_exposure import exposure_of
from vamgpu.printing.verdict import Verdict, verdict_of
from vamgpu.reports.line import Line

if TYPE_CHECKING:
    from vamgpu.methods import Bound
    from vamgpu.methods.tolerances import Corner, CornerDoses
    from vamgpu.printing.given_dose import GivenDose
    from vamgpu.printing.planes import PlaneDose
    from vamgpu.targets.limits import Limits
    from vamgpu.targets.solid import Solid


@dataclass(frozen=True, eq=False, repr=False)
class Proof:
    """A simulated print and its scores.

    Attributes:
        operator: the operator that the frames were solved with.
        frames: the exposed frames.
        name: name of the target.
        target: fractions [x, y, z] on the device.
        dose: dose on the part's own voxels [x, y, z], in units of Aᵀ(light), that is light × mm; on the device.
        scores: the proved scores of the whole volume, from that dose.
        slices: scores of every slice at the volume's scale and threshold.
        light_efficiency: energy absorbed in the part over the optical energy sent; if nothing is absorbed, the mean
            length [mm] of rays inside the part.
        mean_brightness: mean light of all pixels over that of a full-on one.
        claimed: the scores predicted from Aᵀ(light) of the operator itself.
        outer: the greatest dose beside, above and below the judged cylinder; None if no resin is there. The operator's
            own dose covers only its grid.
        independent: whether the dose comes from rays traced independently of the operator, on finer voxels; if not, the
            dose is the operator's own.
        width: width of the fine voxels whose means are the dose [mm].
        agrees: change of the dose on the next finer voxels, relative to the peak; None if not computed.
        exposure: predicted times, if irradiance and critical dose were given.
        solid: the mesh that the target was made from, in the same place; None for an array or a folder.
        limits: limits of single voxels, by which `scores` and `slices` judge them; None for a single threshold.
        bound: upper bound of the window of any patterns, from the operator's own dose, at all corners if tolerances
            were given; None if not computed.
        corners: doses of the frames at every corner of tolerances; None if not computed.
        planes: dose of the bit planes, each at the angles at which a rig shows it; None if not computed.
        given: the dose that a run gave, relative to the proved one; None for a proof of frames.
        off: errors of the machine that exposed the frames; None for the machine of the job.
        history: records of the run that found the patterns, as in `Plan`; empty if none were recorded.
    """

    operator: Projection
    frames: Any
    name: str
    target: DeviceArray
    dose: DeviceArray
    scores: Scores
    slices: SliceScores
    light_efficiency: float
    mean_brightness: float
    claimed: Scores
    outer: Outer | None = None
    independent: bool = False
    width: float | None = None
    agrees: float | None = None
    exposure: ExposureTimes | None = None
    solid: Solid | None = None
    limits: Limits | None = None
    bound: Bound | None = None
    corners: CornerDoses | None = None
    planes: PlaneDose | None = None
    given: GivenDose | None = None
    off: Corner | None = None
    history: Sequence[Mapping[str, Any]] = ()

    def __repr__(self) -> str:
        proved = f"proved {self.scores.window:+.4f}" if self.independent else f"not proved {self.scores.window:+.4f}"
        return f"Proof({self.name!r}: strict window {proved}, claimed {self.claimed.window:+.4f})"

    def _repr_html_(self) -> str:
        dose = target = None
        if drawable(self.dose.shape):
            dose, target = (values.numpy()[:, :, values.shape[2] // 2] for values in (self.dose, self.target))
        planes = {
            "dose, middle slice": dose,
            "printed": None if dose is None else (dose >= self.scores.threshold).astype(float),
            "target": target,
        }
        known = "judgement" in self.__dict__
        verdict = self.verdict.sentence if known else "not computed yet: read .verdict (ten projector evaluations)"
        numbers = {"verdict": verdict} | {line.name: line.value for line in self.lines()}
        return card(f"Proof of {self.name!r}", numbers, planes)

    @property
    def seconds(self) -> float | None:
        """Predicted exposure [s]."""
        return self.exposure.seconds if self.exposure else None

    part_share: ClassVar[Renamed] = Renamed("light_efficiency")

    @cached_property
    def idle_light(self) -> float:
        """Share of the light sent by pixels whose rays never meet the part; takes one forward projection."""
        light = self.frames.irradiance(self.operator.device)
        return idle_light(self.operator, light, lit_pixels(self.operator, self.target))

    @property
    def dose_name(self) -> str:
        """What its latitude scales: with oxygen, the effective dose, which is not proportional to the exposure."""
        return "effective dose" if isinstance(self.operator, OxygenModel) else "dose"

    @property
    def ratio(self) -> float:
        """The proved window over the predicted one; NaN if no window is predicted."""
        return self.scores.window / self.claimed.window if self.claimed.window > 0 else float("nan")

    @cached_property
    def difference(self) -> float:
        """Greatest difference of the solver's dose from the proved one, over the peak; takes half an evaluation."""
        own = self.operator.T(self.frames.irradiance(self.operator.device)).numpy()
        return float(np.abs(own - self.dose.numpy())[self.operator.grid.cylinder()].max() / (self.scores.peak or 1.0))

    @property
    def outer_share(self) -> float:
        """The greatest dose beyond the judged cylinder over the threshold; at 1, resin there prints. 0: unknown."""
        return self.outer.dose / (self.solid_from or 1.0) if self.outer else 0.0

    @property
    def solid_from(self) -> float:
        """Least dose that makes resin solid: the threshold, or less if a body prints with less."""
        return self.scores.threshold * (self.limits.void if self.limits else 1.0)

    @cached_property
    def parts(self) -> Parts:
        """The dose relative to the limits of its voxels, and the classes that scores count."""
        return judged_parts(self.dose, self.target, self.limits)

    @cached_property
    def bodies(self) -> tuple[BodyDose, ...]:
        """Doses of the bodies of a scene; empty for a single part."""
        if self.limits is None:
            return ()
        grid, at = self.operator.grid, self.scores.threshold
        return body_doses(self.dose.numpy(), self.target.numpy(), self.limits, at, grid)

    def fine(self, reach: float | None = None, above: float = 0.0) -> Iterator[FineSlab]:
        """Compute the dose again, on voxels at most half as wide as those of the part, and as a column in the resin.

        See `IndependentExposure.fine`.

        Args:
            reach: Farthest from the axis [mm]; the inner wall by default. With only the judged cylinder,
                ``operator.grid.inscribed_radius``, it takes a fraction of the time.
            above: Height above the grid and depth below it that are included [mm].

        Returns:
            Slabs from the bottom up, one at a time.

        Raises:
            BadInput: The dose is the operator's own, and there is no finer one.
        """
        exposure = exposure_of(self.operator) if self.independent else None
        if exposure is None:
            raise BadInput(
                "the dose is the operator's own, and there is none on finer voxels; simulate a Projection without "
                "coarse=True, or read Proof.dose"
            )
        light = self.frames.irradiance(self.operator.device)
        return exposure.fine(light, reach, above)

    @cached_property
    def judgement(self) -> Judgement:
        """The print judged below the voxel size, see its `lines`; its first use takes about ten evaluations."""
        return judged(self)

    @cached_property
    def joined(self) -> Solid | None:
        """The mesh without the surfaces where its bodies overlap."""
        return joined(self.solid) if self.solid else None

    @cached_property
    def unjudged(self) -> Unjudged:
        """Features of the part that are too thin for its voxels; no score counts them."""
        return unjudged(self.target.numpy(), self.operator.grid, self.joined)

    @cached_property
    def unjudged_voxels(self) -> int:
        """Number of voxels of the part beyond the judged cylinder; no score counts them."""
        return int(above(replace(self.parts, reach=EVERYWHERE), 0.0)[0, IN].sum()) - self.scores.in_voxels

    @property
    def all_correct(self) -> bool:
        """Whether the part prints, according to independent rays."""
        return self.independent and self.verdict.prints

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the part prints, and what is wrong if it does not; needs `judgement`."""
        return verdict_of(self, self.judgement)

    @property
    def outside_over_inside(self) -> float:
        """Mean dose of the judged voxels outside the part / mean dose in it."""
        return outside_over_inside(self.dose, self.parts.target)

    def printed(self) -> np.ndarray:
        """Boolean [x, y, z]: voxels that solidify; only within the inscribed cylinder."""
        return (self.dose.numpy() >= self.solid_from) & self.operator.grid.cylinder()[:, :, None]

    def histogram(self, bins: int = 256) -> Histogram:
        """Number of voxels per bin of dose, from 0 to the greatest: outside the part, and inside.

        Args:
            bins: Number of bins.

        Returns:
            The histogram.
        """
        return histogram(self.parts, bins, top=self.scores.peak)

    def lines(self) -> tuple[Line, ...]:
        """Every score with its meaning."""
        s, w = self.scores, self.scores.windows
        share = "fraction of the light that the part absorbs; the rest is absorbed elsewhere or leaves the resin"
        share = share if absorbs(self.operator) else "mean path of light inside the part: nothing is absorbed"
        idle = "fraction of the light from pixels whose rays never meet the part"
        bright = "mean over all pixels and angles / a full-on pixel, regardless of where the light goes"
        outside = "mean dose of judged voxels outside the part / mean dose in it; at 1 both get the same"
        found = [
            *((Line("machine with errors", str(self.off), "the frames are exposed on it"),) if self.off else ()),
            Line("process window, strict", f"{w.strict:+.4f}", "(least dose in the part − greatest outside) / peak"),
            *_judged(self),
            *_bounded(self),
            *_cornered(self),
            *((self.planes.line(),) if self.planes else ()),
            *(self.given.lines() if self.given else ()),
            Line("process window, 0.1 %", f"{w.fine:+.4f}", "0.1 % quantile in the part − 99.9 % outside"),
            Line("process window, 1 %", f"{w.trimmed:+.4f}", "1 % quantile in the part − 99 % outside"),
            Line("process window, one-sided", f"{w.one_sided:+.4f}", "least dose in the part − 99 % quantile outside"),
            Line("IoU", f"{s.iou:.5f}", "intersection over union at the best threshold"),
            Line("VER", f"{s.error_rate:.3e}", "voxels on the wrong side of that threshold"),
            Line("overlap", f"{s.overlap_rate:.3e}", "voxels outside whose dose is at least the least dose inside"),
            Line("IPDR", f"{s.dose_range:.4f}", "range of the dose in the part / peak"),
            Line("threshold", f"{s.threshold / (s.peak or 1.0):.4f}", "least dose that prints / peak"),
            Line("wrong voxels", f"{s.missing:,} + {s.excess:,}", "missing in the part + excess outside"),
            Line("judged voxels", f"{s.in_voxels:,} + {s.out_voxels:,}", "in the part + outside, in the cylinder"),
            *_not_judged(self),
            *(body.line() for body in self.bodies),
            Line("light efficiency", efficiency(self), share),
            Line("idle light", f"{100 * self.idle_light:.3g} %", idle),
            Line("mean brightness", f"{100 * self.mean_brightness:.3g} %", bright),
            Line("dose outside over inside", f"{self.outside_over_inside:.3f}", outside),
        ]
        return (*found, *(_times(self.exposure) if self.exposure else ()))

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write a job folder with the dose and all numbers, which `vamgpu.load` reads.

        Args:
            path: The folder.
            overwrite: Replace an existing job folder.

        Returns:
            The path.

        Raises:
            BadInput: A folder cannot describe the operator, or the frames are those of a run.
            StorageError: The path exists, or cannot be written.
        """
        # avoids a circular import: it makes proofs
        from vamgpu.printing.proof_folder import save_proof

        return save_proof(self, path, overwrite=overwrite)

    def report(self, path: str | Path, plan: Any = None, judgement: Judgement | None = None) -> Path:
        """Write one self-contained HTML page with pictures.

        Args:
            path: Path of the page.
            plan: Plan whose convergence and papers the page shows.
            judgement: Windows and surface that the page shows; by default `Proof.judgement`.

        Returns:
            The path.

        Raises:
            StorageError: The page cannot be written.
        """
        # avoids a circular import: reports take `efficiency`
        from vamgpu.printing.report import page_of

        return page_of(self, plan, judgement).write(path)


def _bounded(proof: Proof) -> tuple[Line, ...]:
    """The widest possible window, if it is known."""
    if proof.bound is None:
        return ()
    own, dose = proof.claimed.window, "from the same dose"
    if proof.corners is not None:
        own, dose = proof.corners.window, "at all corners, from traced rays"
    reached = f"this one has {own:+.4f} {dose}, {100 * proof.bound.share(own):.0f} %"
    on = f" on {proof.bound.on}" if proof.bound.on else ""
    most = f"no patterns can exceed it{on}; {reached}"
    return (Line("process window, at most", f"{proof.bound.value:+.4f}", most),)


def _cornered(proof: Proof) -> Iterator[Line]:
    """The windows at the corners of tolerances, if they are known."""
    if proof.corners is None:
        return
    doses, count = proof.corners, len(proof.corners.corners)
    held = f"least in the part at {doses.darkest.name}, most outside at {doses.leakiest.name}"
    yield Line("process window, tolerances", f"{doses.window:+.4f}", f"one threshold for {count} corners; {held}")
    for number, corner in enumerate(doses.corners):
        yield Line(f"window, corner {number}", f"{corner.window:+.4f}", f"{corner.name}; with its own threshold")


def _judged(proof: Proof) -> Iterator[Line]:
    """The dose that was judged, and the predicted window."""
    if proof.independent:
        agrees = "" if proof.agrees is None else f"; finer voxels change the dose by ≤ {proof.agrees:.1g} of the peak"
        voxels = "finer voxels" if proof.width is None else f"voxels of {1e3 * proof.width:.3g} µm"
        yield Line("judged by", "traced rays", f"each voxel of the part is the mean of {voxels}{agrees}")
        if isinstance(proof.operator, OxygenModel):
            yield Line("dose by the solver", f"{proof.difference:.3g}", "greatest difference from the proof's / peak")
        yield Line(
            "window by the solver",
            f"{proof.claimed.window:+.4f}",
            "the strict window that the solver's operator predicts",
        )
        yield Line(
            "proved over predicted",
            f"{proof.ratio:.3f}" if isfinite(proof.ratio) else "–",
            "strict window from traced rays / predicted one, if that is above 0",
        )
    else:
        yield Line("judged by", "its own operator", "nothing is proved: no independent rays were traced")
    if proof.outer is not None:
        where = f"greatest dose / threshold, {proof.outer.where}"
        yield Line("dose beyond the cylinder", f"{proof.outer_share:.3f}", where)


def _not_judged(proof: Proof) -> Iterator[Line]:
    """Lines about features of the part that no score counts; none if everything is judged."""
    if proof.unjudged:
        yield Line("not judged", f"{proof.unjudged.volume:.3g} mm³", proof.unjudged.reason())
    if proof.unjudged_voxels:
        where = "voxels of the part outside the cylinder that light reaches at every angle; use a wider grid"
        yield Line("part beyond the cylinder", f"{proof.unjudged_voxels:,}", where)


def efficiency(proof: Proof) -> str:
    """The light efficiency with its unit."""
    if absorbs(proof.operator):
        return f"{100 * proof.light_efficiency:.3g} %"
    return f"{proof.light_efficiency:.3g} mm"


def _seconds(value: float | None) -> str:
    return "not computed" if value is None else f"{value:.3g} s" if isfinite(value) else "never"


def _times(exposure: ExposureTimes) -> tuple[Line, ...]:
    return (
        Line("exposure", f"{exposure.seconds:.3g} s", f"until resin at the threshold is solid, at {exposure.given}"),
        Line("part complete", _seconds(exposure.complete), "until the last voxel of the part is solid"),
        Line("first excess", _seconds(exposure.overcure_onset), "until the first voxel outside is solid"),
        Line("optical energy", f"{exposure.energy / 1e3:.3g} J", "sent until the end of the exposure"),
    )
