"""Planning functions for tests, good and nasty ones; they run in a process of their own."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from vamgpu.hosts.live.worker import Desk


def levels(desk: Desk, level: float = 9, dtype: type = np.uint8) -> list[np.ndarray]:
    return [np.full(desk.task["shape"], level, dtype)] * desk.task["projectors"]


def good(desk: Desk) -> None:
    """Frames of level 9 from turn 1 on, of level 5 from turn 2 on, an end after turn 3, and what it believes."""
    desk.estimate([("sensitivity", 0.9, 0.05)])
    desk.propose(levels(desk, 9), 1)
    for told in desk:
        if "shown" in told and told["shown"]["slot"].max() >= desk.task["frames"]:
            desk.propose(levels(desk, 5, float), 2, stop=3)
            break
    for _ in desk:
        pass


def nonsense(desk: Desk) -> None:
    """All that is no version of this print, then one that is."""
    task, plain = desk.task, levels(desk)
    right: dict[str, Any] = {"print": task["print"], "levels": [[plain[0]]], "turn": 1, "stop": None}
    nan = levels(desk, 7, float)[0].copy()
    nan[3, 2, 1] = np.nan
    wrong = [
        {"levels": [[nan]]}, {"levels": [[levels(desk, -1, np.int16)[0]]]}, {"levels": [[levels(desk, 256, float)[0]]]},
        {"levels": [[levels(desk, np.inf, float)[0]]]}, {"levels": [[plain[0][:-1]]]},
        {"levels": [[plain[0]], [plain[0]]]},
        {"levels": [[levels(desk, 255)[0]]]}, {"print": "another"}, {"turn": 0}, {"turn": 99}, {"turn": "soon"},
        {"stop": 1}, {"levels": 5}, {"levels": []},
    ]  # fmt: skip
    for each in wrong:
        desk.tell({"version": right | each})
    desk.tell({"version": 5})
    desk.tell({"parameters": [("gain", float("nan"), 1.0)]})
    desk.tell({"parameters": [("gain", 1.0, 0.1, 1.2, 0.8)]})
    for maps in (5, {"dose": np.zeros((4, 4), np.uint8)}, {"dose": np.zeros((4, 4, 3))}, {"dose": "red"}):
        desk.tell({"maps": maps})
    desk._line.send_bytes(b"\xff no message")
    desk.tell({"version": right})
    for _ in desk:
        pass


def late(desk: Desk) -> None:
    """A version for a turn that has begun."""
    for told in desk:
        if "shown" in told and told["shown"]["slot"].max() >= desk.task["frames"]:
            desk.propose(levels(desk), 1)
            return


def stalls(desk: Desk) -> None:
    """Reads nothing and says nothing."""
    time.sleep(60)


def dies(desk: Desk) -> None:
    """Is killed once it has made one version."""
    desk.propose(levels(desk), 1)
    desk.heard(10)
    while (told := desk.heard(10)) is not None and "answer" not in told:
        pass
    os._exit(9)


def counts(desk: Desk) -> None:
    """Proposes a turn whose level is the number of images that were seen in the first, and tells their angles."""
    images, angles = 0, []
    for told in desk:
        if "image" in told:
            images += 1
            angles.append(told["angle"])
        elif "shown" in told and told["shown"]["slot"].max() >= 15:
            desk.estimate([("images", images, 0.0), ("angle", max(angles, default=-1.0), 0.0)])
            desk.propose(levels(desk), 1)
            return


def steady(desk: Desk) -> None:
    """Proposes the turn after the next, again and again."""
    turn = 0
    for told in desk:
        if "shown" in told and (now := int(told["shown"]["slot"].max()) // desk.task["frames"] + 2) > turn:
            turn = now
            if turn < desk.task["turns"]:
                desk.propose(levels(desk, turn), turn)


def rolls(desk: Desk) -> None:
    """Of a web: segment 1 alone, then a part of a segment, then all from segment 3 on."""
    desk.propose(levels(desk, 9), 1)
    for told in desk:
        if "shown" in told and told["shown"]["slot"].max() >= desk.task["frames"]:
            one = levels(desk, 5)[0]
            desk.propose([one[:-1]], 2)
            desk.propose([np.concatenate([one, one[:10]])], 3)
            break
    for _ in desk:
        pass


def raises(desk: Desk) -> None:
    """Fails as a function with an error in it does."""
    next(iter(desk))
    raise ZeroDivisionError


def nan(desk: Desk) -> None:
    """Proposes no numbers."""
    for turn in (1, 2):
        desk.propose(levels(desk, np.nan, float), turn)
    for _ in desk:
        pass


def silent(desk: Desk) -> None:
    """Takes the first message, and is late for all others."""
    next(iter(desk))
    time.sleep(60)
