"""Hosts that are killed while they print: the controller, a separate process, switches the light off in one lease."""

from __future__ import annotations

import json
import os
import queue
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.safety.interlock import DEFAULT_LENGTH

LANES, KILLS = 4, 8
PREROLL = 2


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def awaited(what: Callable[[], Any], seconds: float = 300.0) -> Any:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if found := what():
            return found
        time.sleep(0.005)
    raise AssertionError("what was waited for never came")


@dataclass
class Killed:
    """What was seen of one host.

    beyond: from the end of its lease to that of the light [ns].  lit: whether it died in the light.  alone: whether the
    light was on after its death.
    """

    beyond: int
    lit: bool
    alone: bool


@dataclass
class Lane:
    """A controller, and one host after the other on it."""

    name: str
    folder: Path
    hosts: Any
    said: queue.Queue[tuple[str, str]] = field(default_factory=queue.Queue)
    told: int = 0

    @property
    def log(self) -> Path:
        return self.folder / f"{self.name}.log"

    def changes(self, since: int = 0) -> list[dict[str, Any]]:
        whole = self.log.read_text().rpartition("\n")[0]
        return [json.loads(line) for line in whole.splitlines()[since:]]

    def until(self, *wanted: str) -> tuple[str, int]:
        """Listen for one of some words; the word and its number, and how many frames were told to be kept."""
        while (said := self.said.get(timeout=300))[0] not in wanted:
            self.told = int(said[1]) if said[0] == "kept" else self.told
        return said[0], int(said[1] or 0)

    def killed(self, number: int, chance: random.Random) -> Killed | None:
        """Let a host print, kill it at some moment after it was allowed light, and look at what it left.

        Its folder has all frames that it told were written down, and those triggered up to a lease before it was last
        heard: a host that polls no more does not renew. None for one that gave up before, as on a machine too busy.
        """
        run, before, self.told = self.folder / f"{self.name}.{number}", len(self.changes()), 0
        self.hosts.write(f"{self.name} {self.folder / self.name} {self.log} {run}\n")
        self.hosts.flush()
        child = self.until("pid")[1]
        if self.until("on", "dead")[0] == "dead":
            return None
        if number % 4:  # in the light of the frames, else some time before
            with suppress(AssertionError):
                awaited(lambda: any("light" in each for each in self.changes(before)), 5.0)
        time.sleep(chance.uniform(0.0, 0.6 if number % 4 else 2.0))
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        dead = self.until("dead")[1]
        awaited(lambda: len(closes := [each["close"] for each in self.changes(before) if "close" in each]) > 2)
        seen, kept = self.changes(before), read_run(run)
        light = [(change["due_ns"], change["light"]) for change in seen if "light" in change]
        assert (not light or light[-1][1] == 0) and kept.shown["slot"].tolist() == list(range(len(kept.shown)))
        if kept.state is not PrintState.PRINTING:
            return None
        lit = next((channels for at, channels in reversed(light) if at <= dead), 0)
        triggers = [change["done_ns"] for change in seen if "trigger" in change]
        leases = [change for change in seen if "lease" in change]
        heard = leases[-2]["done_ns"]  # what answered this one was awaited before the last one was asked for
        assert self.told <= len(kept.shown) <= max(len(triggers) - PREROLL, 0)
        assert len(kept.shown) >= sum(at < heard - DEFAULT_LENGTH for at in triggers) - PREROLL
        end = light[-1][0] if light else 0
        return Killed(end - leases[-1]["lease"], bool(lit), end > dead)


def heard(lines: Any, lanes: dict[str, Lane]) -> None:
    """Hand out what the hosts say."""
    for line in lines:
        name, kind, *value = line.split()
        lanes[name].said.put((kind, " ".join(value)))


def work(lane: Lane, found: list[Killed]) -> None:
    chance = random.Random(int(lane.name))
    time.sleep(0.4 * int(lane.name))  # not all at once
    kills, number = 0, 0
    while kills < KILLS:  # hosts that gave up for want of a processor do not count
        death = lane.killed(number, chance)
        kills, number = kills + (death is not None), number + 1
        if death is not None:
            found.append(death)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_killed_host_leaves_no_light(tmp_path: Path) -> None:
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
    kills: list[Killed] = []
    with ExitStack() as stack:
        command = [sys.executable, str(Path(__file__).with_name("killed_hosts.py"))]
        hosts = stack.enter_context(subprocess.Popen(command, env=environment(), **pipes))
        stack.callback(hosts.kill)
        lanes = {str(number): Lane(str(number), tmp_path, hosts.stdin) for number in range(LANES)}
        for lane in lanes.values():
            lane.log.touch()
            serve = [str(Path(__file__).with_name("servers.py")), "--link", str(tmp_path / lane.name), "--log"]
            controller = subprocess.Popen([sys.executable, *serve, str(lane.log)], env=environment())
            stack.enter_context(controller)
            stack.callback(controller.kill)
        awaited(lambda: all((tmp_path / name).is_symlink() for name in lanes))
        threading.Thread(target=heard, args=(hosts.stdout, lanes), daemon=True).start()
        with ThreadPoolExecutor(LANES) as pool:
            for done in [pool.submit(work, lane, kills) for lane in lanes.values()]:
                done.result()
    assert len(kills) == LANES * KILLS
    latest = max(each.beyond for each in kills)
    assert latest <= 0, f"light {latest / 1e6:.1f} ms beyond the lease of a host that was dead"
    assert sum(each.lit for each in kills) >= len(kills) // 4, "many died in the light"
    assert sum(each.alone for each in kills) >= len(kills) // 4, "the controller went on by itself until it closed"
