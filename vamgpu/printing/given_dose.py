"""The dose that a print gives, relative to the proved dose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Self

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.quantity import counted
from vamgpu.reports.line import Line
from vamgpu.storage.reading import malformed

if TYPE_CHECKING:
    from vamgpu.printing.proof import Proof

WITHIN = 0.01  # relative deviation of a dose from the proved one that is always allowed


@dataclass(frozen=True)
class ProvedDose:
    """The exposure of a proof."""

    seconds: float  # exposure until resin at the threshold is solid, all angles together [s]
    irradiance: float  # irradiance of a full-on pixel during that exposure [mW/mm²]
    scale: float  # light of a full-on pixel, in the plan's units
    # least and greatest dose, relative to the proved one, at which it prints (`Verdict.latitude`): 1 ± `WITHIN` or more
    least: float
    most: float
    right: bool  # whether it prints at the proved dose
    faults: str = ""  # what is wrong if it does not

    @classmethod
    def of(cls, proof: Proof) -> Self:
        """The exposure of a proof. Raises `BadInput` if the proof has no times."""
        if proof.exposure is None:
            raise BadInput(f"the proof of {proof.name!r} has no times; expected irradiance and critical_dose: prove "
                           "the frames with both")  # fmt: skip
        verdict, times = proof.verdict, proof.exposure
        least, most = verdict.latitude if verdict.prints else (1.0, 1.0)
        faults = "; ".join(fault.said for fault in verdict.faults)
        least, most = min(least, 1.0 - WITHIN), max(most, 1.0 + WITHIN)
        lamp = times.lamp or times.irradiance
        seconds = times.seconds * times.irradiance / lamp
        return cls(seconds, lamp, proof.frames.scale, least, most, verdict.prints, faults)


@dataclass(frozen=True)
class GivenDose:
    """The dose that a print of a vial gives."""

    proved: ProvedDose
    share: float  # the dose, relative to the proved one
    turns: int
    seconds: float  # from the first light to the last [s]
    lit: float = 1.0  # share of the rig's full light in these turns; 1 is not dimmed
    drive: bool = False  # whether the drive of the lamp was dimmed; otherwise frames are lit for a shorter time
    asked: bool = False  # whether the user chose the number of turns

    @classmethod
    def read(cls, kept: Mapping[str, Any] | None) -> Self | None:
        """The dose in a run's folder, as `plain` wrote it; None if it has none. Raises `StorageError`."""
        if kept is None:
            return None
        with malformed("the dose in the record of the run is malformed", "its folder was changed"):
            found = cls(**{**kept, "proved": ProvedDose(**kept["proved"])})
            positive("dose", found.share)
            positive("exposure", found.proved.seconds)
        return found

    def plain(self) -> dict[str, Any]:
        """The values by name, for JSON."""
        return asdict(self)

    @property
    def keeps(self) -> bool:
        """Whether the verdict at this dose is the proved one."""
        return self.proved.least <= self.share <= self.proved.most

    @property
    def whole(self) -> bool:
        """Whether the exposure is as long as a good verdict requires."""
        return self.share >= self.proved.least

    def __str__(self) -> str:
        return f"{self.share:.3f} times the proved dose: {self.verdict}"

    @property
    def verdict(self) -> str:
        """The effect of the dose on the verdict of the proof."""
        low, high = f"{self.proved.least:.3f}", f"{self.proved.most:.3f}"
        if not self.proved.right:
            if self.keeps:
                return "the part does not print at this dose"
            return "the part does not print even at the proved dose"
        if self.keeps:
            return f"within {low} to {high}, where everything two pixels or more from the surface prints correctly"
        if self.share < self.proved.least:
            return f"below {low}, so that some of the part stays liquid"
        return f"above {high}, so that resin beside the part solidifies"

    def lines(self) -> tuple[Line, ...]:
        """Turns, seconds and dose for reports."""
        light = self.share * self.proved.seconds
        chosen = "chosen by the user" if self.asked else "whole turns"
        found = [
            Line("dose given over proved", f"{self.share:.3f}", self.verdict),
            Line("exposure given", f"{light:.3g} s", f"of {self.proved.seconds:.3g} s proved, at the irradiance of the "
                 "proof"),
            Line("turns", f"{self.turns}", f"{chosen}, {self.seconds:.2f} s"),
        ]  # fmt: skip
        return (*found, *((Line("dimmed", f"{self.lit:.3f}", self.dimming),) if self.lit < 1.0 else ()))

    @property
    def dimming(self) -> str:
        """The dimming of the light, and the dose without it."""
        share = f"{100 * self.lit:.1f} %"
        what = f"the lamp has {share} of its drive" if self.drive else f"frames are lit for {share} of their time"
        return f"{what}; otherwise {counted(self.turns, 'turn')} would give {self.share / self.lit:.3f} times the dose"
