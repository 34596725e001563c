"""A web that is replanned while it is printed, and the function that does; it runs in a process of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vamgpu.hosts.live.worker import PlannerClient
from vamgpu.live import WebDrift, WebReplanner
from vamgpu.losses.band import Band
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.webs.store import WebFolder
from vamgpu.webs.stream import Stream


def bars() -> Stream:
    """A web of five segments, whose lamp could be 1.6 times as bright."""
    film = Film(thickness=1.0, resin_index=1.49, bath_index=1.33, absorption=0.2)
    roller = Roller(radius=3.0, film=film, step=float(np.radians(9.0)))

    def solid(along: np.ndarray, rho: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.sin(np.pi * along / 8.0) + 0.0 * (rho + z)

    return Stream(
        solid, roller, roller.beam(0.25, 4),
        method=Band.thresholds(0.5, 0.8, 1.2), length=150.0, core=1.0, iterations=20, scale=4.4, speed=0.8,
    )  # fmt: skip


WEAK = 110
"""The frame from which the lamp gives four fifths."""


def mends(planner: PlannerClient) -> None:
    """Of that web: once the weak lamp was seen, the segment after the next, one by one."""
    plan = WebFolder.open(planner.task["jobs"][0])
    web, done = (plan,), 0
    for told in planner:
        if "shown" not in told or (slot := int(told["shown"]["slot"].max())) < WEAK:
            continue
        horizon = slot // planner.task["frames"] + 2
        if horizon > done and horizon < planner.task["turns"]:
            done, path = horizon, Path(planner.task["folder"]).parent / f"{horizon}.vam"
            new = WebReplanner(bars(), WebDrift(0.8, WEAK), iterations=10).write(path, web, horizon, count=1)
            planner.propose([new.read("frames", *new.segments[horizon].frames)], horizon)
            web = (new, plan)
