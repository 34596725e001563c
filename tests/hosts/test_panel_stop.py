"""A print that is stopped from its live page, or over the network: it is dark before the stop has returned.

Times are those of the emulated rig, in the process of the print: a busy machine brings the press later, not the dark.
"""

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

from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

HOST = """
    import json, sys
    from vamgpu.hosts.panel import server as panels
    from vamgpu.hosts.records.state import Board
    from vamgpu.hosts.rig import carry_out, plan, rehearsal
    from vamgpu.hosts.rigs.config import read_rig

    panels.STARTING = 200.0
    planned = plan(sys.argv[1], read_rig("emulated", ["safety.lease=1 s"]), speed=40, turns=20)
    board = Board(job="part")
    with panels.Panel(board) as panel:
        print(panel.url, flush=True)
        sys.stdin.readline()
        rig = rehearsal(planned, paced=True)
        emulated, stop, stops = rig.emulated, board.stop, []

        def noted(why):
            stops.append(emulated.clock.now())
            stop(why)
            stops.append(emulated.clock.now())

        board.stop = noted
        state, _ = carry_out(planned, rig.machines, sys.argv[2], board)
        emulated.clock.sleep(1_500_000_000)
        lit = [(start, end) for start, end, *_ in emulated.controller.intervals]
        seen = {"state": state.value, "lit": lit, "light": emulated.controller.light, "stops": stops}
        print(json.dumps(seen), flush=True)
        sys.stdin.readline()
"""


class Host:
    """A process that prints on emulated machines in real time, each preview lit for a quarter of a second."""

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
        line = http.client.HTTPConnection(self.url.split("/")[2], timeout=30)
        line.request(method, path, headers={"Authorization": f"Bearer {self.url.partition('token=')[2]}"})
        return json.loads(line.getresponse().read())

    def prints(self, slots: int) -> None:
        """Wait until so many previews were shown and the light is on."""
        while not ((now := self.line("GET", "/state"))["light"] and now["slot"] >= slots):
            time.sleep(0.02)
            assert self.process.poll() is None and now["state"] in ("standby", "printing"), now


@pytest.fixture
def host(tmp_path: Path) -> Iterator[Host]:
    made = Host(tmp_path)
    try:
        yield made
    finally:
        made.process.kill()
        made.process.wait()


def stopped(host: Host, press: Callable[[], None]) -> None:
    """Print, press, and compare what the emulated lamp did with when the stop began and returned [ns]."""
    host.stdin.write("print\n")
    host.prints(3)
    press()
    seen = json.loads(host.stdout.readline())
    assert seen["state"] == "cancelled" and not seen["light"]
    (began, returned), lit = seen["stops"], [end - start for start, end in seen["lit"]]
    dark = seen["lit"][-1][1]
    assert dark <= returned, f"light {(dark - began) / 1e6:.1f} ms after the stop began, which had returned"
    run = read_run(host.run)
    assert run.state is PrintState.CANCELLED and run.shown["slot"].tolist() == list(range(len(run.shown)))
    on, slack = int(run.shown["on_time"][0]), 20_000_000
    assert len(lit) >= 4 and min(lit[:-1]) > on - slack and max(lit) < on + slack, "none was cut but the last"
    assert len(run.shown) in (len(lit), len(lit) - 1), "what was lit was written down, but for one that was cut"


@pytest.mark.slow
def test_a_stop_over_the_network(host: Host) -> None:
    def press() -> None:
        assert not host.line("POST", "/stop")["light"], "it answers when it is dark"

    stopped(host, press)
    assert read_run(host.run).message == "emergency stop at the panel"


@pytest.mark.slow
def test_the_button_of_a_page_opened_before_the_print(host: Host) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        page = needs.page(tools)
        page.goto(host.url)
        page.get_by_test_id("state").get_by_text("standby").wait_for()
        assert page.get_by_test_id("pause").count() == 0

        def press() -> None:
            page.get_by_test_id("pause").wait_for()
            page.get_by_test_id("cancel").wait_for()
            page.get_by_test_id("stop").click()

        stopped(host, press)
        page.get_by_test_id("light").get_by_text("off").wait_for()
        page.get_by_test_id("state").get_by_text("cancelled").wait_for()  # the lamp is told before the print
        page.get_by_test_id("message").get_by_text("emergency stop at the panel").wait_for()
