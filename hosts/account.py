"""How much of its light each view got, from the record of a run: known, unknown, and what was wanted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.hosts.schedules.schedule import NONE, Schedule

if TYPE_CHECKING:
    from vamgpu.hosts.record import RunRecord

WITHIN = 0.01
"""The share of its light that a view of a complete print may lack."""


def wanted_light(schedule: Schedule) -> np.ndarray:
    """Light that a schedule gives each of its frames [ns], int64 (frames,)."""
    lit = schedule.frame != NONE
    frames = max(schedule.frames, int(schedule.frame.max(initial=-1)) + 1)
    wanted = np.zeros(frames, np.int64)
    np.add.at(wanted, schedule.frame[lit], schedule.on[lit])
    return wanted


@dataclass(frozen=True, eq=False)
class LightAccount:
    """Light of the views of a run: a view is a frame of a projector.

    Attributes:
        wanted: What was planned [ns], (engines, frames).
        sure: What was given for certain [ns], of the same shape.
        unsure: What was given or not, since the light went off at an unknown time [ns], of the same shape.
        versions: The same of each version of the frames, where these were replaced.
    """

    wanted: np.ndarray
    sure: np.ndarray
    unsure: np.ndarray
    versions: Mapping[int, LightAccount] = field(default_factory=dict)

    @property
    def views(self) -> int:
        """How many views have light in the plan."""
        return int(np.count_nonzero(self.wanted))

    @property
    def short(self) -> np.ndarray:
        """Views that may lack more than `WITHIN` of their light, in any version, bool (engines, frames)."""
        lacking = self.sure < self.wanted * (1 - WITHIN)
        return np.any([lacking, *(each.short for each in self.versions.values())], axis=0)

    @property
    def complete(self) -> bool:
        """Whether every view has its light."""
        return not self.short.any()

    def share(self, unsure: float) -> np.ndarray:
        """Light over what was wanted, (engines, frames); 1 where none was wanted.

        Args:
            unsure: How much of the unknown light counts, 0 to 1.

        Returns:
            Shares, 0 and more.
        """
        got = self.sure + unsure * self.unsure
        return np.where(self.wanted > 0, got / np.maximum(self.wanted, 1), 1.0)

    def facts(self) -> dict[str, Any]:
        """What a run's folder tells of it."""
        short = self.short
        least, most = (self.share(unsure)[short] for unsure in (0.0, 1.0))
        return {
            "views": self.views, "short": int(short.sum()), "complete": self.complete,
            "least_share": float(least.min(initial=1.0)), "most_share": float(most.min(initial=1.0)),
        } | (
            {"versions": {str(number): each.facts() for number, each in self.versions.items()}} if self.versions else {}
        )  # fmt: skip

    def __str__(self) -> str:
        if self.complete:
            return f"all {self.views} views have their light"
        told = self.facts()
        low, high = (100 * told[name] for name in ("least_share", "most_share"))
        band = f"{low:.0f} %" if round(low) == round(high) else f"{low:.0f} to {high:.0f} %"
        return f"complete but for {told['short']} of {self.views} views: the darkest has {band} of its light"


def account(run: RunRecord, wanted: np.ndarray | None = None, *, versions: bool = True) -> LightAccount | None:
    """What the record of a run tells of the light of its views.

    Args:
        run: The record.
        wanted: Light of each frame [ns], (frames,), of each projector alike; by default what the folder keeps of it.
        versions: Whether frames that took the place of others are views of their own; else all are the job's, and all
            planned turns are wanted.

    Returns:
        The account; None for the folder of a version that did not keep what was wanted.
    """
    kept: Mapping[str, Any] | None = run.asked.get("views")
    if wanted is None and kept is None:
        return None
    if wanted is None:
        assert kept is not None
        wanted = np.broadcast_to(np.asarray(kept["on_ns"], np.int64), (kept["frames"],))
    shown = run.shown
    lit = (shown["dark"] == 0) & (shown["frame"] >= 0)
    engines = max(int((kept or {}).get("engines", 1)), int(shown["engine"].max(initial=0)) + 1)
    unsure = np.zeros(len(shown), bool)
    for event in run.events:
        if event["event"] == "unseen":
            unsure |= (shown["slot"] >= event["first"]) & (shown["slot"] < event["stop"])

    def counted(wanted: np.ndarray, among: np.ndarray | bool = True) -> LightAccount:
        got = []
        for those in (lit & ~unsure & among, lit & unsure & among):
            light = np.zeros((engines, len(wanted)), np.int64)
            np.add.at(light, (shown["engine"][those], shown["frame"][those]), shown["on_time"][those])
            got.append(light)
        return LightAccount(np.broadcast_to(wanted, (engines, len(wanted))), *got)

    shares = version_shares(run.events, len(wanted)) if versions else None
    if shares is None:
        return counted(wanted)
    each = {
        number: counted((wanted * share).astype(np.int64), shown["version"] == number)
        for number, share in shares.items()
    }
    return replace(counted((wanted * sum(shares.values())).astype(np.int64)), versions=each)


def version_shares(events: Sequence[Mapping[str, Any]], frames: int) -> dict[int, np.ndarray] | None:
    """Which share of the planned light of each frame a version has, (frames,); None where none was replaced.

    All frames of a vial come round in each turn; those of a web belong to one segment.
    """
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
    """What a run's folder keeps of the light that is wanted."""
    wanted = wanted_light(schedule)
    alike = bool((wanted == wanted[:1]).all())
    return {"engines": schedule.engines, "frames": len(wanted),
            "on_ns": int(wanted[0]) if alike and len(wanted) else wanted.tolist()}  # fmt: skip
