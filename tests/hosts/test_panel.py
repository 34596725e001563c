"""The live page in a real headless browser, who may open it, and a stop that does not wait for the print."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from typing import Any

import needs
import numpy as np
import pytest

from vamgpu.errors import BadInput, DeviceError
from vamgpu.hosts.board import Board
from vamgpu.hosts.panel import Panel, loopback
from vamgpu.hosts.state import State


def asked(panel: Panel, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes, str]:
    line = http.client.HTTPConnection("127.0.0.1", panel.port, timeout=20)
    line.request(method, path, headers=headers)
    answer = line.getresponse()
    return answer.status, answer.read(), answer.getheader("set-cookie") or ""


@pytest.fixture
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        chromium = tools.chromium.launch(executable_path=needs.browser(), args=["--no-sandbox", "--disable-gpu"])
        yield chromium
        chromium.close()


def test_the_page_shows_and_stops(browser: Any) -> None:
    board = Board(job="boat", slots=360, unit="deg")
    stopped: list[str] = []
    happened = threading.Event()

    def light_off(why: str) -> None:
        stopped.append(why)
        board.show(light=False, state=State.CANCELLED, message=why)
        happened.set()

    paused: list[bool] = []
    board.on_stop(light_off)
    board.button("pause", lambda: paused.append(True))
    picture = np.zeros((40, 60), np.uint8)
    picture[10:30, 20:40] = 255
    board.show(state=State.PRINTING, frame=17, slot=17, position=17.0, focus=-1.25, fill=0.5, margin=4_200_000)
    board.show(light=True, power=0.8, picture=picture)
    with Panel(board) as panel:
        assert panel.token is None and loopback(panel.host)
        page = browser.new_page(viewport={"width": 1000, "height": 800})
        page.goto(panel.url)
        text = lambda name: page.get_by_test_id(name).inner_text()  # noqa: E731
        page.get_by_test_id("light").get_by_text("ON at 0.8").wait_for()
        assert text("state") == "printing" and text("frame") == "17 (slot 17 of 360)"
        assert (text("position"), text("focus"), text("buffer")) == ("17.000 deg", "-1.250 dpt", "50 % full")
        assert text("timing margin") == "4.20 ms"
        assert page.get_by_test_id("picture").locator("img").get_attribute("src").startswith("data:image/png")
        board.show(frame=18, slot=18, fill=0.25)
        page.get_by_test_id("frame").get_by_text("18 (slot 18 of 360)").wait_for()
        assert text("buffer") == "25 % full"
        page.get_by_test_id("pause").click()
        page.get_by_test_id("stop").click()
        assert happened.wait(10)
        page.get_by_test_id("light").get_by_text("off").wait_for()
        assert text("state") == "cancelled: emergency stop at the panel"
        assert paused == [True] and stopped == ["emergency stop at the panel"]
    with pytest.raises(DeviceError, match="a process of its own"), Panel(Board()):
        pass


def test_a_program_may_stop_too() -> None:
    board, heard = Board(position=float("nan")), []
    board.on_stop(heard.append)
    with Panel(board, page=False) as panel:
        told = json.loads(asked(panel, "/state")[1])
        assert told["state"] == "standby" and told["position"] is None
        assert asked(panel, "/stop", "POST")[0] == 200
        assert heard == ["emergency stop over the network"]


def test_all_stops_are_called_though_one_fails() -> None:
    board, heard = Board(), []

    def broken(why: str) -> None:
        raise DeviceError("unplugged")

    board.on_stop(broken)
    board.on_stop(heard.append)
    with pytest.raises(DeviceError):
        board.stop("x")
    assert heard == ["x"]


def test_beyond_this_machine_a_token_is_needed() -> None:
    with Panel(Board(), host="0.0.0.0", page=False) as panel:
        assert panel.token and len(panel.token) >= 24 and panel.token in panel.url
        for path in ("/", "/state", "/state?token=wrong", "/_nicegui/x"):
            assert asked(panel, path)[0] == 403
        assert asked(panel, "/stop", "POST")[0] == 403
        status, _, cookie = asked(panel, f"/state?token={panel.token}")
        assert status == 200 and "HttpOnly" in cookie and "SameSite=Strict" in cookie
        assert asked(panel, "/state", Cookie=cookie.split(";")[0])[0] == 200
    with pytest.raises(BadInput, match="16 characters"):
        Panel(Board(), token="short")


def test_other_sites_are_kept_out_on_loopback() -> None:
    with Panel(Board(), page=False) as panel:
        assert asked(panel, "/state", Host="evil.example")[0] == 403
        assert asked(panel, "/stop", "POST", Origin="http://evil.example")[0] == 403
        own = f"http://127.0.0.1:{panel.port}"
        assert asked(panel, "/stop", "POST", Origin=own)[0] == 200
        with pytest.raises(DeviceError, match="another host or port"):
            Panel(Board(), port=panel.port)
