"""A host that is killed: the controller, a process of its own, closes the light within one lease. A hundred times."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from statistics import median
from typing import Any

LEASE_MS = 60
TIMES = 100
READING_MS = 40
"""What a busy machine may take to let the controller's process read a renewal sent just before the kill."""

HOST = """
    import os, sys, time
    from vamgpu.hosts.clock import RealClock
    from vamgpu.hosts.drivers.controller import Controller
    from vamgpu.hosts.safety.lamp import ControllerLamp, Renewal
    from vamgpu.hosts.safety.lease import Keeper, Lease
    from vamgpu.hosts.safety.light import LightGuard

    def host(port, lease_ms):
        with Controller.open(port) as controller:
            lease = Lease(RealClock(), Renewal(controller), lease_ms * 1_000_000)
            lamp = ControllerLamp(controller, steady=True)
            with LightGuard(lamp, lease, tolerance=1.0) as light, Keeper(lease, light.fail):
                light.look(armed=True, motion=0.0, shown=0, scheduled=0)
                light.on(1.0)
                os.write(1, b"on\\n")
                while True:
                    lease.beat()
                    light.check()
                    time.sleep(0.005)

    for line in sys.stdin:  # a process that has all imports makes one for each host
        child = os.fork()
        if not child:
            host(sys.argv[1], int(sys.argv[2]))
        os.write(1, f"{child}\\n".encode())
        os.waitpid(child, 0)
        os.write(1, f"dead {time.monotonic_ns()}\\n".encode())
"""


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def changes(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_text().splitlines()]


def awaited(what: Any, seconds: float = 30.0) -> Any:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if found := what():
            return found
        time.sleep(0.002)
    raise AssertionError("what was waited for never came")


def test_a_killed_host_leaves_no_light(tmp_path: Path) -> None:
    link, log = tmp_path / "port", tmp_path / "log"
    log.touch()
    serve = [sys.executable, "-m", "vamgpu.hosts.emulators.controller", "--link", str(link), "--log", str(log)]
    breed = [sys.executable, "-c", textwrap.dedent(HOST), str(link), str(LEASE_MS)]
    chance, after = random.Random(7), []
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
    with (
        subprocess.Popen(serve, env=environment()) as controller,
        subprocess.Popen(breed, env=environment(), **pipes) as hosts,
    ):
        assert hosts.stdin and hosts.stdout
        awaited(link.is_symlink)
        try:
            for number in range(TIMES):
                hosts.stdin.write("go\n")
                said = {hosts.stdout.readline().strip(), hosts.stdout.readline().strip()}
                assert "on" in said
                time.sleep(chance.uniform(0.0, 2.0 * LEASE_MS) / 1e3)
                assert changes(log)[-1]["light"] == 1, "the light was on when the host was killed"
                os.kill(int((said - {"on"}).pop()), signal.SIGKILL)
                dead = int(hosts.stdout.readline().split()[1])
                awaited(lambda number=number: len(changes(log)) == 2 * number + 2)
                off = changes(log)[-1]
                assert off["light"] == 0
                after.append((off["due_ns"] - dead) / 1e6)
        finally:
            hosts.kill()
            controller.terminate()
    assert len(after) == TIMES
    assert max(after) <= LEASE_MS + READING_MS, f"light {max(after):.1f} ms after the host was dead"
    assert median(after) <= LEASE_MS
