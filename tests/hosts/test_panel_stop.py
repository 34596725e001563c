"""A print that is stopped from its live page, or over the network: the light is out within a lease of the press."""

from __future__ import annotations

import http.client
import json
import os
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import needs
import numpy as np
import pytest

from vamgpu.hosts.record import read_run
from vamgpu.hosts.safety.lease import DEFAULT_LENGTH
from vamgpu.hosts.state import State
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

HOST = """
    import json, sys, time
    from vamgpu.hosts.board import Board
    from vamgpu.hosts.panel import Panel
    from vamgpu.hosts.rig import carry_out, plan, rehearsal
    from vamgpu.hosts.rigs.config import read_rig

    planned = plan(sys.argv[1], read_rig("emulated"), speed=40)
    board = Board(job="part")
    with Panel(board) as panel:
        print(panel.url, flush=True)
        sys.stdin.readline()
        stand = rehearsal(planned, paced=True)
        state, _ = carry_out(planned, stand.machines, sys.argv[2], board)
        stand.bench.clock.sleep(500_000_000)
        zero = time.monotonic_ns() - stand.bench.clock.now()
        lit = [(start + zero, end + zero) for start, end, *_ in stand.bench.controller.intervals]
        print(json.dumps({"state": state.value, "lit": lit, "light": stand.bench.controller.light}), flush=True)
        sys.stdin.readline()
"""


class Host:
    """A process that prints on emulated machines in real time, each picture lit for a quarter of a second."""

    def __init__(self, folder: Path) -> None:
        images = np.full((36, 6, 10), 255, np.uint8)
        frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
        self.run = folder / "run"
        path = os.pathsep.join(path for path in sys.path if path)
        command = [sys.executable, "-c", textwrap.dedent(HOST), str(save_frames(folder / "part.vam", frames).path)]
        self.process = subprocess.Popen(
            [*command, str(self.run)], env=os.environ | {"PYTHONPATH": path}, text=True, bufsize=1,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        assert self.process.stdin and self.process.stdout
        self.stdin, self.stdout = self.process.stdin, self.process.stdout
        self.url = self.stdout.readline().strip()

    def line(self, method: str, path: str) -> Any:
        """Ask its server."""
        line = http.client.HTTPConnection(self.url.split("/")[2], timeout=20)
        line.request(method, path)
        return json.loads(line.getresponse().read())

    def prints(self, slots: int) -> None:
        """Wait until so many pictures were shown and the light is on."""
        end = time.monotonic() + 30
        while not ((now := self.line("GET", "/state"))["light"] and now["slot"] >= slots):
            assert time.monotonic() < end, now
            time.sleep(0.02)


@pytest.fixture
def host(tmp_path: Path) -> Iterator[Host]:
    made = Host(tmp_path)
    try:
        yield made
    finally:
        made.process.kill()
        made.process.wait()


def stopped(host: Host, press: Callable[[], int]) -> None:
    """Print, press, and hold what the emulated lamp did against when it was pressed [ns]."""
    host.stdin.write("print\n")
    host.prints(3)
    pressed = press()
    told = json.loads(host.stdout.readline())
    assert told["state"] == "cancelled" and not told["light"]
    (start, dark), lit = told["lit"][-1], [end - start for start, end in told["lit"]]
    after = dark - pressed
    assert start < pressed + DEFAULT_LENGTH and after <= DEFAULT_LENGTH, f"light {after / 1e6:.1f} ms after the press"
    run = read_run(host.run)
    assert run.state is State.CANCELLED and run.shown["slot"].tolist() == list(range(len(run.shown)))
    on, slack = int(run.shown["on_time"][0]), 20_000_000
    assert len(lit) >= 4 and min(lit[:-1]) > on - slack and max(lit) < on + slack, "none was cut but the last"
    assert len(run.shown) in (len(lit), len(lit) - 1), "what was lit was written down, but for one that was cut"


def test_a_stop_over_the_network(host: Host) -> None:
    def press() -> int:
        at = time.monotonic_ns()
        assert not host.line("POST", "/stop")["light"], "it answers when it is dark"
        return at

    stopped(host, press)
    assert read_run(host.run).message == "emergency stop over the network"


def test_the_button_of_a_page_opened_before_the_print(host: Host) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        page = tools.chromium.launch(executable_path=needs.browser(), args=["--no-sandbox", "--disable-gpu"]).new_page()
        page.goto(host.url)
        page.get_by_test_id("state").get_by_text("standby").wait_for()
        assert page.get_by_test_id("pause").count() == 0
        page.evaluate("addEventListener('click', event => window.pressed = Date.now(), {capture: true})")

        def press() -> int:
            page.get_by_test_id("pause").wait_for()
            page.get_by_test_id("cancel").wait_for()
            page.get_by_test_id("stop").click()
            between = time.time_ns() - time.monotonic_ns()
            return int(page.evaluate("window.pressed")) * 1_000_000 - between

        stopped(host, press)
        page.get_by_test_id("light").get_by_text("off").wait_for()
        assert page.get_by_test_id("state").inner_text() == "cancelled: emergency stop at the panel"
