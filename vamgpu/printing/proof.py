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
from vamgpu.deprecated import Renamed
from vamgpu.errors import BadInput
from vamgpu.methods.part import idle_light, lit_pixels
from vamgpu.metrics import Parts, Scores, SliceScores
from vamgpu.metrics.histogram import Histogram, above, histogram
from vamgpu.metrics.light import outside_over_inside
from vamgpu.metrics.line import Line
from vamgpu.metrics.mesh_union import joined
from vamgpu.metrics.parts import EVERYWHERE, IN
from vamgpu.metrics.thin_regions import Unjudged, unjudged
from vamgpu.operators.dose_unit import absorbs
from vamgpu.operators.projection import Projection
from vamgpu.printing.beyond_cylinder import Outer
from vamgpu.printing.bodies import BodyDose, body_doses, judged_parts
from vamgpu.printing.exposure import ExposureTimes
from vamgpu.printing.independent_exposure import FineSlab, IndependentExposure
from vamgpu.printing.judgement import Judgement, judged
from vamgpu.printing.verdict import Verdict, verdict_of

if TYPE_CHECKING:
    from vamgpu.methods import Bound
    from vamgpu.methods.tolerances import CornerDoses
    from vamgpu.printing.given_dose import GivenDose
    from vamgpu.printing.planes import PlaneDose
    from vamgpu.targets.limits import Limits
    from vamgpu.targets.solid import Solid


@dataclass(frozen=True, eq=False, repr=False)
class Proof:
    """A simulated print and its scores.

    Attributes:
        operator: what the frames were solved with.
        frames: what was exposed.
        name: of the target.
        target: fractions [x, y, z] on the device.
        dose: on the part's own voxels [x, y, z], in units of Aᵀ(light), that is light × mm; on the device.
        scores: of the whole volume, by that dose: the proved ones.
        slices: of every z at the volume's scale and threshold.
        light_efficiency: energy absorbed in the part over the optical energy sent, or the mean length [mm] of rays
            inside the part where nothing is absorbed.
        mean_brightness: mean light of all pixels over that of a full-on one.
        claimed: the same scores by Aᵀ(light) of the operator itself.
        outer: the greatest dose beside, above and below the judged cylinder; None where there is nothing. By the
            operator's own dose it is that of its grid alone.
        independent: whether the dose is by rays traced apart from the operator, on finer voxels; else it is the
            operator's own.
        width: of the voxels that the dose is a mean of [mm].
        agrees: share of the peak to which the dose on the next finer voxels agrees; None where it was not asked.
        exposure: predicted times, where irradiance and critical dose were given.
        solid: the mesh that the target was made of, in the same place; None where it came from an array or a folder.
        limits: what single voxels are asked for, by which `scores` and `slices` judge them; None where the part is to
            print and nothing else.
        bound: the window that no light whatever exceeds, by the operator's own dose, at all corners where they were
            asked for; None where nobody asked.
        corners: what the frames give at every corner of tolerances; None where nobody asked.
        planes: what they give by bit planes, each at the angles at which a rig shows it; None where nobody asked.
        given: the dose that a run gave, over the one that was proved; None for a proof of frames.
        history: records of the run that found the light, as of `Plan`; empty where nobody kept them.
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
        verdict = self.verdict.sentence if known else "not found yet: read .verdict, about ten projector evaluations"
        numbers = {"verdict": verdict} | {line.name: line.value for line in self.lines()}
        return card(f"Proof of {self.name!r}", numbers, planes)

    @property
    def seconds(self) -> float | None:
        """Predicted exposure [s]."""
        return self.exposure.seconds if self.exposure else None

    part_share: ClassVar[Renamed] = Renamed("light_efficiency")

    @cached_property
    def idle_light(self) -> float:
        """Share of the light sent by pixels whose rays never meet the part; one forward projection."""
        light = self.frames.irradiance(self.operator.device)
        return idle_light(self.operator, light, lit_pixels(self.operator, self.target))

    @property
    def ratio(self) -> float:
        """The proved window over the claimed one; NaN where none is claimed."""
        return self.scores.window / self.claimed.window if self.claimed.window > 0 else float("nan")

    @property
    def outer_share(self) -> float:
        """The greatest dose beyond the judged cylinder over the threshold; from 1 on it prints. 0 if none is known."""
        return self.outer.dose / (self.solid_from or 1.0) if self.outer else 0.0

    @property
    def solid_from(self) -> float:
        """Dose from which resin gets solid: the threshold, or less where a body prints at less."""
        return self.scores.threshold * (self.limits.void if self.limits else 1.0)

    @cached_property
    def parts(self) -> Parts:
        """The dose over the limits of its voxels, and the classes that scores count."""
        return judged_parts(self.dose, self.target, self.limits)

    @cached_property
    def bodies(self) -> tuple[BodyDose, ...]:
        """Doses of the bodies of a scene; empty for a part alone."""
        if self.limits is None:
            return ()
        grid, at = self.operator.grid, self.scores.threshold
        return body_doses(self.dose.numpy(), self.target.numpy(), self.limits, at, grid)

    def fine(self, reach: float | None = None, above: float = 0.0) -> Iterator[FineSlab]:
        """The dose on voxels at most half as wide as the part's and as a column in the resin, computed anew.

        See `IndependentExposure.fine`.

        Args:
            reach: Farthest from the axis [mm]; the inner wall by default. The judged cylinder alone,
                ``operator.grid.inscribed_radius``, takes a fraction of the time.
            above: How far above the grid, and below it [mm].

        Returns:
            Slabs from below, one at a time.

        Raises:
            BadInput: The dose is the operator's own, which has no finer one.
        """
        if not self.independent:
            raise BadInput(
                f"{type(self.operator).__name__} has no rays to trace apart from it, so there is no dose on finer "
                "voxels; prove a Projection, or read Proof.dose"
            )
        light = self.frames.irradiance(self.operator.device)
        return IndependentExposure(self.operator).fine(light, reach, above)

    @cached_property
    def judgement(self) -> Judgement:
        """The print judged below the voxel, see its `lines`. Found when asked: about ten projector evaluations."""
        return judged(self)

    @cached_property
    def joined(self) -> Solid | None:
        """The mesh without the surfaces that its bodies hide in each other."""
        return joined(self.solid) if self.solid else None

    @cached_property
    def unjudged(self) -> Unjudged:
        """Features of the part that are too thin for its voxels, so that no score counts them."""
        return unjudged(self.target.numpy(), self.operator.grid, self.joined)

    @cached_property
    def unjudged_voxels(self) -> int:
        """Voxels of the part beyond the judged cylinder, which no score counts."""
        return int(above(replace(self.parts, reach=EVERYWHERE), 0.0)[0, IN].sum()) - self.scores.in_voxels

    @property
    def all_correct(self) -> bool:
        """Whether it prints, by rays traced for the proof."""
        return self.independent and self.verdict.prints

    @cached_property
    def verdict(self) -> Verdict:
        """Whether it prints, and what is wrong where it does not; takes `judgement`."""
        return verdict_of(self, self.judgement)

    @property
    def outside_over_inside(self) -> float:
        """Mean dose of the judged voxels outside the part over the mean in it."""
        return outside_over_inside(self.dose, self.parts.target)

    def printed(self) -> np.ndarray:
        """Boolean [x, y, z]: voxels that get solid, the inscribed cylinder alone."""
        return (self.dose.numpy() >= self.solid_from) & self.operator.grid.cylinder()[:, :, None]

    def histogram(self, bins: int = 256) -> Histogram:
        """Voxels (out of, in) the part per bin of dose, from 0 to the greatest.

        Args:
            bins: How many bins.

        Returns:
            The histogram.
        """
        return histogram(self.parts, bins, top=self.scores.peak)

    def lines(self) -> tuple[Line, ...]:
        """Every score with its meaning."""
        s, w = self.scores, self.scores.windows
        share = "share of the light sent that is absorbed in the part; the rest heats the void or leaves"
        share = share if absorbs(self.operator) else "mean path of light inside the part: nothing is absorbed"
        idle = "share of the light sent by pixels whose rays never meet the part"
        bright = "mean light of all pixels and angles over a full-on pixel; says nothing of where it goes"
        outside = "mean dose of judged voxels outside the part over the mean in it; 1 lights the void as much"
        found = [
            Line("process window, strict", f"{w.strict:+.4f}", "least dose in the part − greatest outside, over peak"),
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
            Line("overlap", f"{s.overlap_rate:.3e}", "voxels outside that get at least the least dose inside"),
            Line("IPDR", f"{s.dose_range:.4f}", "range of the dose in the part, over peak"),
            Line("threshold", f"{s.threshold / (s.peak or 1.0):.4f}", "printed from this dose on, over peak"),
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
            overwrite: Replace a job folder that stands there.

        Returns:
            The path.

        Raises:
            BadInput: Nothing but Python can describe the operator, or the frames are those of a run.
            StorageError: The path is taken, or cannot be written.
        """
        # a circle: it makes proofs
        from vamgpu.printing.proof_folder import save_proof

        return save_proof(self, path, overwrite=overwrite)

    def report(self, path: str | Path, plan: Any = None, judgement: Judgement | None = None) -> Path:
        """Write one self-contained HTML page with pictures.

        Args:
            path: Of the page.
            plan: Adds its convergence and its papers.
            judgement: Window over tolerance, tolerance table and surface; found by default, see `judged` for the cost.

        Returns:
            The path.

        Raises:
            StorageError: The page cannot be written.
        """
        # a circle: reports take `efficiency`
        from vamgpu.printing.report import write_report

        return write_report(self, path, plan, judgement)


def _bounded(proof: Proof) -> tuple[Line, ...]:
    """The widest window there can be, where it is known."""
    if proof.bound is None:
        return ()
    own, dose = proof.claimed.window, "by the same dose"
    if proof.corners is not None:
        own, dose = proof.corners.window, "at all corners, by traced rays"
    reached = f"this one has {own:+.4f} {dose}, {100 * proof.bound.share(own):.0f} %"
    on = f" on {proof.bound.on}" if proof.bound.on else ""
    most = f"no light whatever gives more{on}; {reached}"
    return (Line("process window, at most", f"{proof.bound.value:+.4f}", most),)


def _cornered(proof: Proof) -> Iterator[Line]:
    """The windows at the corners of tolerances, where they are known."""
    if proof.corners is None:
        return
    told, count = proof.corners, len(proof.corners.corners)
    held = f"least in the part at {told.darkest.name}, most outside at {told.leakiest.name}"
    yield Line("process window, tolerances", f"{told.window:+.4f}", f"one threshold for {count} corners; {held}")
    for number, corner in enumerate(told.corners):
        yield Line(f"window, corner {number}", f"{corner.window:+.4f}", f"{corner.name}; by a threshold of its own")


def _judged(proof: Proof) -> Iterator[Line]:
    """Who judged, and what was claimed."""
    if proof.independent:
        agrees = "" if proof.agrees is None else f", where the next finer ones agree to {proof.agrees:.1g} of the peak"
        voxels = "finer voxels" if proof.width is None else f"voxels of {1e3 * proof.width:.3g} µm"
        yield Line("judged by", "traced rays", f"the part's voxels take the mean of {voxels}{agrees}")
        yield Line(
            "window by the solver",
            f"{proof.claimed.window:+.4f}",
            "the strict window that the solver's operator predicts",
        )
        yield Line(
            "proved over predicted",
            f"{proof.ratio:.3f}" if isfinite(proof.ratio) else "–",
            "the strict window by traced rays over a predicted one above 0",
        )
    else:
        name = type(proof.operator).__name__
        yield Line("judged by", "its own operator", f"{name} has no rays to trace apart from it: nothing is proved")
    if proof.outer is not None:
        where = f"the greatest over the threshold, {proof.outer.where}"
        yield Line("dose beyond the cylinder", f"{proof.outer_share:.3f}", where)


def _not_judged(proof: Proof) -> Iterator[Line]:
    """Lines on the part that no score counts; none where all is judged."""
    if proof.unjudged:
        yield Line("not judged", f"{proof.unjudged.volume:.3g} mm³", proof.unjudged.reason())
    if proof.unjudged_voxels:
        where = "voxels of the part farther from the axis than every angle lights; take a wider grid"
        yield Line("part beyond the cylinder", f"{proof.unjudged_voxels:,}", where)


def efficiency(proof: Proof) -> str:
    """The light efficiency with its unit."""
    if absorbs(proof.operator):
        return f"{100 * proof.light_efficiency:.3g} %"
    return f"{proof.light_efficiency:.3g} mm"


def _times(exposure: ExposureTimes) -> tuple[Line, ...]:
    return (
        Line("exposure", f"{exposure.seconds:.3g} s", f"until the threshold is solid, at {exposure.given}"),
        Line("part complete", f"{exposure.complete:.3g} s", "until the last voxel of the part is solid"),
        Line("first excess", f"{exposure.overcure_onset:.3g} s", "until the first voxel outside is solid"),
        Line("optical energy", f"{exposure.energy / 1e3:.3g} J", "sent until the end of the exposure"),
    )
