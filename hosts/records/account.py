"""The light of each frame in a run, known and unknown, compared with the planned light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.printing.given_dose import GivenDose

if TYPE_CHECKING:
    from vamgpu.hosts.records.record import RunRecord

WITHIN = 0.01  # share of its light that a view of a complete print may lack


def wanted_light(schedule: Schedule) -> np.ndarray:
    """Light of each frame of a schedule [ns], int64 (frames,)."""
    lit = schedule.frame != NONE
    frames = max(schedule.frames, int(schedule.frame.max(initial=-1)) + 1)
    wanted = np.zeros(frames, np.int64)
    np.add.at(wanted, schedule.frame[lit], schedule.on[lit])
    return wanted


@dataclass(frozen=True, eq=False)
class LightAccount:
    """Light of the frames of a run, in ns, arrays (engines, frames)."""

    wanted: np.ndarray  # planned
    sure: np.ndarray  # certain light
    unsure: np.ndarray  # uncertain light: it went off at an unknown time
    versions: Mapping[int, LightAccount] = field(default_factory=dict)  # the same for each version of the frames
    dose: GivenDose | None = None  # dose of all planned light, relative to the proved one; None if unknown
    stopped: bool = False  # whether the print ended before its turns, because the resin scattered enough
    open: bool = False  # whether the record ends while the light was on, so that the light after it is not known

    @property
    def views(self) -> int:
        """Number of frames with light in the plan."""
        return int(np.count_nonzero(self.wanted))

    @property
    def short(self) -> np.ndarray:
        """Views that may lack more than `WITHIN` of their light, in any version, bool (engines, frames)."""
        lacking = self.sure < self.wanted * (1 - WITHIN) if not self.stopped else self.unsure > self.wanted * WITHIN
        return np.any([lacking, *(each.short for each in self.versions.values())], axis=0)

    @property
    def complete(self) -> bool:
        """Whether every view has its light for certain, and the exposure, if known, is complete."""
        whole = self.dose is None or self.dose.whole or self.stopped
        return whole and not self.open and not self.short.any() and not self.doubtful.any()

    @property
    def excess(self) -> np.ndarray:
        """Views that may have more light than plan and dose allow, bool (engines, frames)."""
        allowed = 1 + WITHIN if self.dose is None else max(1 + WITHIN, self.dose.proved.most / self.dose.share)
        return self.sure + self.unsure > self.wanted * allowed

    @property
    def doubtful(self) -> np.ndarray:
        """Views with too much light if all uncertain light was lit; their certain light alone is within the budget."""
        return self.excess & (self.unsure > 0)

    def share(self, unsure: float) -> np.ndarray:
        """Light relative to the plan, (engines, frames); 1 without planned light. unsure: share of unknown light."""
        got = self.sure + unsure * self.unsure
        return np.where(self.wanted > 0, got / np.maximum(self.wanted, 1), 1.0)

    def facts(self) -> dict[str, Any]:
        """The account as stored in a run's folder."""
        short = self.short
        least, most = (self.share(unsure)[short] for unsure in (0.0, 1.0))
        return {
            "views": self.views, "short": int(short.sum()), "complete": self.complete,
            "least_share": float(least.min(initial=1.0)), "most_share": float(most.min(initial=1.0)),
            "in_doubt": int(np.count_nonzero(self.unsure)), "open": self.open, "stopped": self.stopped,
        } | ({} if self.dose is None else {"dose": self.dose.share}) | (
            {"versions": {str(number): each.facts() for number, each in self.versions.items()}} if self.versions else {}
        )  # fmt: skip

    def __str__(self) -> str:
        told = self.facts()
        doubt = f"; {told['in_doubt']} were lit for an unknown time" if told["in_doubt"] else ""
        doubt += "; the record ends while the light was on: the light after it is not known" if self.open else ""
        if self.stopped:
            shares = self.share(0.0)[self.wanted > 0]
            low, high = (100 * float(each) for each in (shares.min(initial=1.0), shares.max(initial=0.0)))
            return f"each of {self.views} frames has {low:.0f} to {high:.0f} % of the light of all turns{doubt}"
        if over := np.count_nonzero(self.excess):
            doubt += f"; {over} may be overexposed: the brightest by {100 * float(self.share(1.0).max()) - 100:.0f} %"
        if not told["short"]:
            dose = "" if self.dose is None else f"; dose {self.dose}"
            return f"all {self.views} frames have their light{doubt}{dose}"
        low, high = (100 * told[name] for name in ("least_share", "most_share"))
        band = f"{low:.0f} %" if round(low) == round(high) else f"{low:.0f} to {high:.0f} %"
        return f"{told['short']} of {self.views} frames are underexposed: the darkest has {band} of its light{doubt}"


def account(
    run: RunRecord, wanted: np.ndarray | None = None, *, versions: bool = True, ended: bool = False
) -> LightAccount | None:
    """The light of a run's frames, by version if wanted; None for folders without it. ended: the light is off."""
    kept: Mapping[str, Any] | None = run.asked.get("views")
    if wanted is None and kept is None:
        return None
    if wanted is None:
        assert kept is not None
        wanted = np.broadcast_to(np.asarray(kept["on_ns"], np.int64), (kept["frames"],))
    shown, dose = run.shown, GivenDose.read(run.asked.get("dose"))
    lit = (shown["dark"] == 0) & (shown["frame"] >= 0)
    engines = max(int((kept or {}).get("engines", 1)), int(shown["engine"].max(initial=0)) + 1)
    unsure = np.zeros(len(shown), bool)
    for first, stop in run.doubt:
        unsure |= (shown["slot"] >= first) & (shown["slot"] < stop)

    died = (run.state is PrintState.PRINTING and not ended) or run.unwritten
    for engine in range(engines) if died else ():  # its last frame may have been cut
        unsure[np.flatnonzero(shown["engine"] == engine)[-1:]] = True
    stopped = any(event["event"] == "enough" for event in run.events)

    def counted(wanted: np.ndarray, among: np.ndarray | bool = True) -> LightAccount:
        got = []
        for those in (lit & ~unsure & among, lit & unsure & among):
            light = np.zeros((engines, len(wanted)), np.int64)
            np.add.at(light, (shown["engine"][those], shown["frame"][those]), shown["on_time"][those])
            got.append(light)
        return LightAccount(
            np.broadcast_to(wanted, (engines, len(wanted))), *got, dose=dose, stopped=stopped, open=died
        )

    shares = version_shares(run.events, len(wanted)) if versions else None
    if shares is None:
        return counted(wanted)
    each = {
        number: counted((wanted * share).astype(np.int64), shown["version"] == number)
        for number, share in shares.items()
    }
    return replace(counted((wanted * sum(shares.values())).astype(np.int64)), versions=each)


def version_shares(events: Sequence[Mapping[str, Any]], frames: int) -> dict[int, np.ndarray] | None:
    """Share of each frame's planned light with a version, (frames,); None if none was replaced."""
    swaps = [event for event in events if event["event"] == "swap"]
    if not swaps:
        return None
    last = swaps[-1]
    numbers = np.zeros(int(last["turns"]), np.int64)
    for swap in swaps:
        numbers[swap["turn"] : swap.get("until")] = swap["version"]
    shown = numbers[: last["stop"]].tolist()
    if last.get("unit") != "segment":
        return {number: np.full(frames, shown.count(number) / len(numbers)) for number in dict.fromkeys(shown)}
    numbers[len(shown) :] = NONE
    each = numbers[np.arange(frames) // int(last["count"])]
    return {number: (each == number).astype(float) for number in dict.fromkeys(shown)}


def views_asked(schedule: Schedule) -> dict[str, Any]:
    """The planned light, as stored in a run's folder."""
    wanted = wanted_light(schedule)
    alike = bool((wanted == wanted[:1]).all())
    return {"engines": schedule.engines, "frames": len(wanted),
            "on_ns": int(wanted[0]) if alike and len(wanted) else wanted.tolist()}  # fmt: skip
