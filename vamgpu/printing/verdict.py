"""Whether frames print their part: the answer, what is wrong, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isnan, sqrt
from typing import TYPE_CHECKING

from vamgpu.metrics.body_changes import BodyChanges
from vamgpu.printing.causes import Causes
from vamgpu.reports.line import length
from vamgpu.units import mW_cm2

if TYPE_CHECKING:
    from vamgpu.printing.judgement import Judgement
    from vamgpu.printing.proof import Proof

ROUGH = 1.0  # pixels by which 95 % of the surface may deviate


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with a print, and how to correct it."""

    said: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.said}: {self.remedy}"


@dataclass(frozen=True)
class Verdict:
    """Whether frames print their part. True if they do; `str` gives the full text.

    Attributes:
        faults: All that is wrong, worst first.
        made: What prints, in words.
        latitude: Least and greatest exposure, relative to the proved one, at which all resin farther than two pixels
            from the surface prints correctly, none beyond the judged cylinder prints, bodies, holes and cavities stay
            as they are, and walls and gaps up to four pixels wide do so at 95 % of the surface. It is searched from
            half to twice the proved exposure; (inf, 0) if there is no such exposure, or a body is already wrong at the
            proved one.
        proved: Whether the verdict comes from rays traced independently of the solver; otherwise it is coarse.
        not_judged: What was not judged, one sentence each; empty if everything was judged.
    """

    faults: tuple[Fault, ...]
    made: str
    latitude: tuple[float, float]
    proved: bool
    not_judged: tuple[str, ...] = ()

    @property
    def prints(self) -> bool:
        """Whether nothing is wrong."""
        return not self.faults

    def __bool__(self) -> bool:
        return self.prints

    @property
    def opening(self) -> str:
        """The first words: whether the part prints, and whether that is proved."""
        if self.proved:
            return "Prints" if self.prints else "Does not print"
        return (
            "Not proved; according to the solver's own dose it prints"
            if self.prints
            else "Does not print according to the solver's own dose"
        )

    @property
    def sentence(self) -> str:
        """One sentence: what prints, or what is wrong."""
        return f"{self.opening}: {self.made if self.prints else '; '.join(fault.said for fault in self.faults)}."

    def __str__(self) -> str:
        remedies = (f"→ {remedy[0].upper()}{remedy[1:]}." for remedy in self.remedies)
        return "\n".join([self.sentence, *remedies, *(f"Not judged: {what}." for what in self.not_judged)])

    @property
    def remedies(self) -> tuple[str, ...]:
        """The remedies, each once."""
        return tuple(dict.fromkeys(one for fault in self.faults for one in fault.remedy.split("; ")))


def verdict_of(proof: Proof, judgement: Judgement) -> Verdict:
    """Give the verdict on a proof."""
    surface, at = judgement.surface, proof.scores.threshold
    least, greatest = judgement.over_tolerance.limits(judgement.deep)
    deep = (at / least, at / greatest if greatest > 0.0 else inf) if least > 0.0 else (inf, 0.0)
    beyond = 1.0 / proof.outer_share if proof.outer_share else inf
    low, most = inf, 0.0
    if surface.thresholds is not None:
        low, most = max(deep[0], at / surface.thresholds[1]), min(deep[1], at / surface.thresholds[0], beyond)
    nothing, causes = isnan(surface.mean), Causes(proof, judgement)
    empty = [Fault("nothing prints", "use a longer exposure, or a brighter lamp")] if nothing else []
    faults = [*_dose(proof), *empty, *_stray(proof), *_bodies(surface.changes, causes)]
    if not nothing and (deep[0] > 1.0 or deep[1] <= 1.0):
        other = f"expose {sqrt(low * most):.3g} times as long" if low < most else causes.deep
        faults.append(Fault(f"resin more than {length(judgement.deep)} from the surface prints incorrectly", other))
    if surface.p95 > ROUGH * judgement.pixel:
        faults.append(Fault(f"5 % of the surface deviates by more than {length(surface.p95)}", causes.rough))
    faults += _left(proof, causes)
    latitude = f"; the {proof.dose_name} may be {_percent(1.0 - low, 0.5)} lower or {_percent(most - 1.0, 1.0)} higher"
    times = proof.exposure
    exposed = f"; {times.seconds:.3g} s, {times.turning}" if times else ""
    near = "" if nothing else f", 95 % of the surface within {length(surface.p95)}"
    return Verdict(tuple(faults), f"{_made(surface.changes)}{near}{latitude}{exposed}", (low, most), proof.independent,
                   judgement.not_judged)  # fmt: skip


def _dose(proof: Proof) -> Iterator[Fault]:
    """A run whose dose differs from the proved one, and a lamp too dim for the turns of a path."""
    if proof.given is not None and not proof.given.keeps:
        yield Fault(f"the dose is {proof.given}", "leave out --turns; the number of turns then matches the exposure")
    times = proof.exposure
    if times is not None and times.enough_turns:
        needed = f"{times.irradiance / mW_cm2:.4g} mW/cm² full-on in {times.turning}"
        yield Fault(f"the dose takes {needed}, more than the lamp has",
                    f"use {times.enough_turns:,} turns or more, longer turns, or a brighter lamp")  # fmt: skip


def _stray(proof: Proof) -> Iterator[Fault]:
    """Resin that solidifies beyond the judged cylinder."""
    if proof.outer is not None and proof.outer_share >= 1.0:
        where = f"{proof.outer.where}, {proof.outer_share:.2f} of the threshold"
        yield Fault(
            f"resin beyond the judged cylinder also prints ({where})",
            "move the part away from the wall, or use more evaluations of the default method: it keeps this resin dark",
        )  # fmt: skip


def _bodies(changes: BodyChanges, causes: Causes) -> Iterator[Fault]:
    """Bodies, holes and cavities that differ from the part's."""
    kinds = (
        ("bodies_lost", "body of the part does not print", "bodies of the part do not print"),
        ("bodies_broken", "body is broken", "bodies are broken"),
        ("bodies_merged", "body joins another one", "bodies join another one"),
        ("bodies_extra", "loose body prints beside the part", "loose bodies print beside the part"),
        ("holes_closed", "hole of the part is closed", "holes of the part are closed"),
        ("holes_opened", "hole opens that is not in the part", "holes open that are not in the part"),
        ("cavities_filled", "cavity is filled", "cavities are filled"),
        ("cavities_extra", "void is left in the part", "voids are left in the part"),
    )
    for kind, one, many in kinds:
        if number := getattr(changes, kind):
            yield Fault(f"{number:,} {one if number == 1 else many}", causes.body(kind, number))


def _left(proof: Proof, causes: Causes) -> Iterator[Fault]:
    """Bodies with the wrong dose, and voxels that were not judged."""
    for body in proof.bodies:
        if body.role == "gray" and body.wrong:
            yield Fault(
                f"{body.name!r} gets the wrong dose in {body.wrong:,} of {body.voxels:,} voxels",
                f"give it a wider tolerance; {causes.light}",
            )
    if proof.unjudged_voxels:
        yield Fault(
            f"{proof.unjudged_voxels:,} voxels of the part lie beyond the judged cylinder", "use a wider grid"
        )  # fmt: skip
    if proof.unjudged:
        yield Fault(proof.unjudged.found(), "use smaller voxels or thicker walls")


def _made(changes: BodyChanges) -> str:
    """Bodies, holes and cavities in words."""
    counted = [(changes.bodies, "body", "bodies"), (changes.holes, "hole", "holes"),
               (changes.cavities, "cavity", "cavities")]  # fmt: skip
    named = [f"{number:,} {one if number == 1 else many}" for number, one, many in counted if number]
    return f"{' and '.join([', '.join(named[:-1]), named[-1]] if named[1:] else named)} as in the part"


def _percent(share: float, searched: float) -> str:
    """A share in percent; ``searched``: the greatest one that is searched for."""
    shown = f"{100.0 * share:.0f} %" if share >= 0.1 else f"{100.0 * share:.2g} %"
    return f"at least {shown}" if share > searched - 1e-6 else shown
