"""Planning functions for tests, good and nasty ones; they run in a process of their own."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from vamgpu.errors import ShapeMismatch
from vamgpu.hosts.live.worker import PlannerClient


def levels(planner: PlannerClient, level: float = 9, dtype: type = np.uint8) -> list[np.ndarray]:
    return [np.full(planner.task["shape"], level, dtype)] * planner.task["projectors"]


def good(planner: PlannerClient) -> None:
    """Frames of level 9 from turn 1 on, of level 5 from turn 2 on, an end after turn 3, and what it believes."""
    planner.estimate([("sensitivity", 0.9, 0.05)])
    planner.propose(levels(planner, 9), 1)
    for told in planner:
        if "shown" in told and told["shown"]["slot"].max() >= planner.task["frames"]:
            planner.propose(levels(planner, 5, float), 2, stop=3)
            break
    for _ in planner:
        pass


def nonsense(planner: PlannerClient) -> None:
    """All that is no version of this print, then one that is."""
    task, plain = planner.task, levels(planner)
    right: dict[str, Any] = {"print": task["print"], "levels": [[plain[0]]], "turn": 1, "stop": None}
    nan = levels(planner, 7, float)[0].copy()
    nan[3, 2, 1] = np.nan
    wrong = [
        {"levels": [[nan]]}, {"levels": [[levels(planner, -1, np.int16)[0]]]},
        {"levels": [[levels(planner, 256, float)[0]]]},
        {"levels": [[levels(planner, np.inf, float)[0]]]}, {"levels": [[plain[0][:-1]]]},
        {"levels": [[plain[0]], [plain[0]]]},
        {"levels": [[levels(planner, 255)[0]]]}, {"print": "another"}, {"turn": 0}, {"turn": 99}, {"turn": "soon"},
        {"stop": 1}, {"levels": 5}, {"levels": []},
    ]  # fmt: skip
    for each in wrong:
        planner.tell({"version": right | each})
    planner.tell({"version": 5})
    planner.tell({"parameters": [("gain", float("nan"), 1.0)]})
    planner.tell({"parameters": [("gain", 1.0, 0.1, 1.2, 0.8)]})
    for checks in (5, [("images", 1, float("nan"), 15.0)], [("images", 1.5, 2.0, 15.0)], [("images", 1, 2.0, 0.0)]):
        planner.tell({"checks": checks})
    for maps in (5, {"dose": np.zeros((4, 4), np.uint8)}, {"dose": np.zeros((4, 4, 3))}, {"dose": "red"}):
        planner.tell({"maps": maps})
    planner._line.send_bytes(b"\xff no message")
    planner.tell({"version": right})
    for _ in planner:
        pass


def doubts(planner: PlannerClient) -> None:
    """Finds images right, then wrong, and proposes nothing but what is planned."""
    planner.checked([("images", 1, 3.0, 15.0), ("conversion", 1, 0.1, 0.35)])
    planner.checked([("images", 2, 30.0, 15.0)], "the camera moved")
    planner.propose(levels(planner, 9), 1)
    for _ in planner:
        pass


def late(planner: PlannerClient) -> None:
    """A version for a turn that has begun."""
    for told in planner:
        if "shown" in told and told["shown"]["slot"].max() >= planner.task["frames"]:
            planner.propose(levels(planner), 1)
            return


def stalls(planner: PlannerClient) -> None:
    """Reads nothing and says nothing."""
    time.sleep(60)


def dies(planner: PlannerClient) -> None:
    """Is killed once it has made one version."""
    planner.propose(levels(planner), 1)
    planner.receive(10)
    while (told := planner.receive(10)) is not None and "answer" not in told:
        pass
    os._exit(9)


def counts(planner: PlannerClient) -> None:
    """Proposes a turn whose level is the number of images that were seen in the first, and tells their angles."""
    images, angles = 0, []
    for told in planner:
        if "image" in told:
            images += 1
            angles.append(told["angle"])
        elif "shown" in told and told["shown"]["slot"].max() >= 15:
            planner.estimate([("images", images, 0.0), ("angle", max(angles, default=-1.0), 0.0)])
            planner.propose(levels(planner), 1)
            return


def steady(planner: PlannerClient) -> None:
    """Proposes the turn after the next, again and again."""
    turn = 0
    for told in planner:
        if "shown" in told and (now := int(told["shown"]["slot"].max()) // planner.task["frames"] + 2) > turn:
            turn = now
            if turn < planner.task["turns"]:
                planner.propose(levels(planner, turn), turn)


def rolls(planner: PlannerClient) -> None:
    """Of a web: segment 1 alone, then a part of a segment, then all from segment 3 on."""
    planner.propose(levels(planner, 9), 1)
    for told in planner:
        if "shown" in told and told["shown"]["slot"].max() >= planner.task["frames"]:
            one = levels(planner, 5)[0]
            planner.propose([one[:-1]], 2)
            planner.propose([np.concatenate([one, one[:10]])], 3)
            break
    for _ in planner:
        pass


def raises(planner: PlannerClient) -> None:
    """Fails as a function with an error in it does."""
    next(iter(planner))
    raise ZeroDivisionError


def refuses(planner: PlannerClient) -> None:
    """Fails as a function does that is given the wrong images."""
    next(iter(planner))
    raise ShapeMismatch("the images are 3 × 3; expected 480 × 640")


def nan(planner: PlannerClient) -> None:
    """Proposes no numbers."""
    for turn in (1, 2):
        planner.propose(levels(planner, np.nan, float), turn)
    for _ in planner:
        pass


def silent(planner: PlannerClient) -> None:
    """Takes the first message, and is late for all others."""
    next(iter(planner))
    time.sleep(60)
