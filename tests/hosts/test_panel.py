"""The live page in a real headless browser, who may open it, and a stop that does not wait for the print."""

from __future__ import annotations

import http.client
import io
import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import needs
import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from vamgpu.errors import BadInput, DeviceError
from vamgpu.hosts.panel import Panel, auth, view
from vamgpu.hosts.panel import server as panels
from vamgpu.hosts.panel.routes import LONGEST, RateLimit
from vamgpu.hosts.records.record import RunFolder
from vamgpu.hosts.records.state import Board, Estimated, PrintState, StateChange
from vamgpu.printing.scatter import ScatterReading


def asked(panel: Panel, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes, str]:
    """The answer to a program that has the token."""
    return stranger(panel, path, method, **{"Authorization": f"Bearer {panel.token}"} | headers)


def stranger(panel: Panel, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes, str]:
    line = http.client.HTTPConnection("127.0.0.1", panel.port)
    line.request(method, path, headers=headers)
    answer = line.getresponse()
    return answer.status, answer.read(), answer.getheader("set-cookie") or ""


@pytest.fixture
def page() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        yield needs.page(tools, viewport={"width": 1000, "height": 800})


@pytest.fixture(autouse=True)
def a_busy_machine_may_start_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(panels, "STARTING", 200.0)


def test_the_page_shows_and_stops(page: Any) -> None:
    board = Board(job="boat", slots=360, unit="deg")
    stopped: list[str] = []
    pressed: list[str] = []

    def light_off(why: str) -> None:
        stopped.append(why)
        board.show(light=False, state=PrintState.CANCELLED, message=why)

    board.on_stop(light_off)
    for name in ("pause", "resume", "cancel"):
        board.button(name, lambda name=name: pressed.append(name))
    preview = np.zeros((40, 60), np.uint8)
    board.show(state=PrintState.PRINTING, frame=17, slot=17, position=17.0, focus=-1.25, fill=0.5, margin=4_200_000)
    board.show(light=True, power=0.8, preview=preview, others=(preview + 1,), left=75.0, polled=time.monotonic() + 1e6)
    board.show(lease=0.25, renewed=0.04)
    by = page.get_by_test_id
    with Panel(board) as panel:
        page.goto(panel.url)
        by("light").get_by_text("ON at 80 %").wait_for()
        text = lambda name: by(name).inner_text()  # noqa: E731
        assert text("state") == "printing" and text("frame") == "17 (slot 18 of 360)"
        assert (text("position"), text("lens"), text("time left")) == ("17.000 deg", "-1.250 dpt", "1 min 15 s")
        assert text("lease") == "light off 210 ms after the host falls silent; last renewal 40 ms ago"
        for name in ("projector 1", "projector 2"):
            assert by(name).evaluate("async (image) => { await image.decode(); return image.naturalWidth }") == 60
        assert by("resume").is_disabled() and "can continue" in by("resume").get_attribute("title")
        lamp = Estimated("lamp", 0.9, 0.05, (0.5, 1.5))
        board.show(plan=2, stop=7, parameters=(lamp, Estimated("stop [turn]", 7.0, 0.0)))
        bar = by("lamp").get_by_role("img", name="usual from 0.5 to 1.5")
        bar.wait_for()
        found = bar.locator("rect.found")
        assert [float(found.get_attribute(name)) for name in ("x", "width")] == pytest.approx([35.0, 10.0])
        assert text("lamp") == "0.9 ± 0.050" and text("plan") == "version 2, until turn 7"
        assert by("stop [turn]").locator("svg").count() == 0
        board.show(unit="mm")
        by("plan").get_by_text("until segment 7").wait_for()
        board.show(frame=18, slot=18)
        by("frame").get_by_text("18 (slot 19 of 360)").wait_for()
        by("cancel").click()
        by("keep").click()
        with page.expect_response("**/press/pause"):
            by("pause").click()
        by("cancel").click()
        with page.expect_response("**/press/cancel"):
            by("really").click()
        assert pressed == ["pause", "cancel"]
        by("stop").click()
        by("light").get_by_text("off").wait_for()
        by("message").get_by_text("emergency stop at the panel. 341 of 360 slots were not shown.").wait_for()
        assert text("state") == "cancelled" and by("pause").is_disabled() and by("cancel").is_disabled()
        assert stopped == ["emergency stop at the panel"]
    by("lost").wait_for()
    assert text("state") == "connection lost" and page.locator("body.stale").count() == 1
    with Panel(Board(), page=False):
        pass  # a process may serve more than one print


def test_a_phone_scrolls_one_way_and_has_the_stop_in_view(page: Any) -> None:
    page.set_viewport_size({"width": 390, "height": 700})
    board = Board(job="a" * 90, preview=np.zeros((900, 1600), np.uint8), message="m" * 200)
    with Panel(board) as panel:
        page.goto(panel.url)
        page.get_by_test_id("state").get_by_text("standby").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        page.evaluate("scrollTo(0, 1e6)")
        box = page.get_by_test_id("stop").bounding_box()
        assert box["y"] + box["height"] <= 700 and box["height"] >= 60 and box["width"] >= 300


def test_a_program_may_stop_too() -> None:
    board, heard = Board(position=float("nan")), []
    board.on_stop(heard.append)
    with Panel(board, page=False) as panel:
        told = json.loads(asked(panel, "/state")[1])
        assert told["state"] == "standby" and told["position"] is None
        assert asked(panel, "/stop", "POST")[0] == 200
        assert heard == ["emergency stop at the panel"]
        assert asked(panel, "/")[0] == 404


def test_how_long_a_print_that_waits_can_go_on_is_told() -> None:
    for left, told in ((3000.0, 3000.0), (-5.0, 0.0)):
        board = Board(state=PrintState.HELD, deadline=time.monotonic() + left)
        assert told - 1000.0 < view.told(board, view.ImageStore())["waits"] <= told
    assert view.told(Board(), view.ImageStore())["waits"] is None


@pytest.mark.parametrize("state", list(PrintState))
def test_buttons_follow_the_state(state: PrintState) -> None:
    pressed: list[str] = []
    board = Board(state=state)
    for name in ("pause", "resume", "cancel"):
        board.button(name, lambda name=name: pressed.append(name))
    with Panel(board, page=False) as panel:
        offered = json.loads(asked(panel, "/state")[1])["buttons"]
        for name, why in offered.items():
            status, said, _ = asked(panel, f"/press/{name}", "POST")
            assert status == (200 if why is None else 409) and (why is None or said.decode() == why)
        assert pressed == [name for name, why in offered.items() if why is None]
        assert (offered["pause"] is None) == (state is PrintState.PRINTING)
        assert (offered["resume"] is None) == (state.value in ("paused", "held"))
        assert (offered["cancel"] is None) == (not state.ended)
        assert asked(panel, "/press/none", "POST")[0] == 404


def test_a_stop_waits_behind_no_button_that_hangs() -> None:
    board, leave, stopped = Board(), threading.Event(), threading.Event()

    def slow_press() -> None:
        leave.wait()

    board.button("slow", slow_press)
    board.on_stop(lambda why: stopped.set())
    with Panel(board, page=False) as panel:
        slow = [threading.Thread(target=asked, args=(panel, "/press/slow", "POST")) for _ in range(60)]
        for each in slow:
            each.start()
        assert asked(panel, "/stop", "POST")[0] == 200 and stopped.is_set()
        leave.set()
        for each in slow:
            each.join()


def test_an_image_is_encoded_once_however_many_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    monkeypatch.setattr(view, "_encoded", lambda image: made.append(1) or b"png")
    board = Board(preview=np.zeros((4, 4), np.uint8))
    with Panel(board, page=False) as panel:
        first = json.loads(asked(panel, "/state")[1])["images"]
        for _ in range(20):
            assert asked(panel, "/image/projector%201")[:2] == (200, b"png")
        assert len(made) == 1
        board.show(preview=np.zeros((4, 4), np.uint8))
        assert json.loads(asked(panel, "/state")[1])["images"] != first
        asked(panel, "/image/projector%201")
        assert len(made) == 2 and asked(panel, "/image/camera")[0] == 404


def test_what_is_estimated_is_shown_in_color() -> None:
    drawn = np.zeros((30, 80, 3), np.uint8)
    drawn[:, :40] = (200, 30, 40)
    with Panel(Board(maps={"dose; in parts": drawn}), page=False) as panel:
        state = json.loads(asked(panel, "/state")[1])
        assert set(state["images"]) == {"dose; in parts"} and "maps" not in state
        status, png, *_ = asked(panel, "/image/dose%3B%20in%20parts")
    assert status == 200 and np.array_equal(np.asarray(Image.open(io.BytesIO(png))), drawn)


def test_many_pages_look_less_often() -> None:
    now = [0.0]
    limit = RateLimit(lambda: now[0])
    assert limit.count() == 0.25
    for _ in range(20):  # 200 pages that do as they are told
        now[0] += limit.wait / 200
        for _ in range(200 * 4):
            now[0] += limit.wait / 200
            limit.count()
    assert 4.0 < limit.wait < 6.0
    for _ in range(100):  # one that is left
        now[0] += limit.wait
        limit.count()
    assert limit.wait == 0.25


def test_the_curve_keeps_its_last_reading() -> None:
    readings = [ScatterReading(float(k), k / 10, False) for k in range(1001)]
    with Panel(Board(scatter=readings, threshold=0.35), page=False) as panel:
        told = json.loads(asked(panel, "/scatter")[1])
    assert told["threshold"] == 0.35 and len(told["points"]) <= 400 and told["points"][-1] == [1000.0, 100.0]


def test_no_page_looks_so_seldom_that_it_is_blind() -> None:
    now = [0.0]
    limit = RateLimit(lambda: now[0])
    for _ in range(10_000):
        now[0] += 0.001
        limit.count()
    assert limit.wait == LONGEST


def test_a_program_that_asks_without_a_pause_slows_no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    polls: list[str] = []
    monkeypatch.setattr(RateLimit, "count", lambda self: polls.append("count") or self.wait)
    with Panel(Board(), page=False) as panel:
        assert [json.loads(asked(panel, "/state")[1])["wait"] for _ in range(3)] == [0.25] * 3 and not polls
        asked(panel, "/state?page")
    assert polls == ["count"]


@pytest.mark.parametrize("error", [None, DeviceError("the motor stalled")])
def test_the_page_outlives_its_print(monkeypatch: pytest.MonkeyPatch, error: DeviceError | None) -> None:
    from vamgpu.cli import print as command

    waited: list[bool] = []
    monkeypatch.setattr(command, "_wait", lambda screen: waited.append(True))
    with nullcontext() if error is None else pytest.raises(DeviceError), command._outlived(Console(quiet=True)):
        if error is not None:
            raise error
    assert waited == [True]


def test_prints_of_the_past_are_told(tmp_path: Path) -> None:
    for number, state in enumerate((PrintState.COMPLETE, PrintState.ERROR)):
        with RunFolder.begin(tmp_path / f"{number}.run", {"jobs": ["some/boat.vam"]}, "") as folder:
            folder.event("segment", 0)
            folder.state(StateChange(PrintState.PRINTING, state, f"why {number}"))
        os.utime(folder.path / "state.json", (number, number))
    (tmp_path / "0.run" / "report.html").write_text("<p>proof")
    (tmp_path / "0.run" / "rig.toml").write_text("secret")
    (tmp_path / "torn.run").mkdir()
    (tmp_path / "torn.run" / "state.json").write_text("{")
    with Panel(Board(), page=False, runs=tmp_path, run="0.run") as panel:
        told = json.loads(asked(panel, "/history")[1])
        assert [(each["name"], each["job"], each["state"]) for each in told] == [
            ("1.run", "boat.vam", "error"), ("0.run", "boat.vam", "complete"),
        ]  # fmt: skip
        assert told[1]["reports"] == ["report.html"] and told[0]["message"] == "why 1" and told[0]["seconds"] >= 0
        status, body, _ = asked(panel, "/runs/0.run/report.html")
        assert (status, body) == (200, b"<p>proof")
        for path in (
            "0.run/rig.toml",
            "1.run/report.html",
            "../report.html",
            "..%2f0.run/report.html",
            "x/report.html",
        ):
            assert asked(panel, f"/runs/{path}")[0] == 404


def test_all_stops_are_called_though_one_fails() -> None:
    board, heard = Board(), []

    def broken(why: str) -> None:
        raise DeviceError("unplugged")

    board.on_stop(broken)
    board.on_stop(heard.append)
    with pytest.raises(DeviceError):
        board.stop("x")
    assert heard == ["x"]


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_every_account_needs_the_token(host: str) -> None:
    with Panel(Board(), host=host) as panel:
        assert panel.token and len(panel.token) >= 24 and panel.token in panel.url
        for path in ("/", "/state", "/page.js", "/history", "/runs/x/report.html", f"/state?token={panel.token}"):
            assert stranger(panel, path)[0] == 403, "a token is taken at the page alone"
        for path in ("/stop", "/press/pause"):
            assert stranger(panel, path, "POST")[0] == 403
        status, body, cookie = stranger(panel, f"/?token={panel.token}")
        assert status == 200 and b'url=/"' in body and panel.token.encode() not in body and panel.token not in cookie
        assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        known = {"Cookie": cookie.split(";")[0]}
        assert stranger(panel, "/state", **known)[0] == 200
        assert stranger(panel, "/state", Authorization=f"Bearer {panel.token}")[0] == 200
        assert stranger(panel, "/state", Host=f"evil.example:{panel.port}", **known)[0] == 403
        assert stranger(panel, "/stop", "POST", Origin="http://evil.example", **known)[0] == 403
        assert stranger(panel, "/stop", "POST", Origin="null", **known)[0] == 403
        assert stranger(panel, "/stop", "POST", Origin=f"http://127.0.0.1:{panel.port}", **known)[0] == 200
    with pytest.raises(BadInput, match="16 characters"):
        Panel(Board(), token="short")


def test_tokens_are_not_guessed_and_an_open_page_is_not_locked_out() -> None:
    with Panel(Board(), token="a token of the lab") as panel:
        known = {"Cookie": stranger(panel, panel.url.partition(str(panel.port))[2])[2].split(";")[0]}
        tried = [stranger(panel, f"/?token=wrong{number}")[0] for number in range(auth.WRONG + 1)]
        assert tried == [403] * auth.WRONG + [429]
        assert asked(panel, "/state")[0] == 429
        assert stranger(panel, "/stop", "POST", **known)[0] == 200


def test_another_account_locks_nobody_out_by_wrong_tokens() -> None:
    with Panel(Board(), page=False) as panel:
        assert {stranger(panel, "/state", Authorization="Bearer wrong")[0] for _ in range(2 * auth.WRONG)} == {403}
        assert asked(panel, "/stop", "POST")[0] == 200


def test_every_answer_keeps_other_sites_out() -> None:
    with Panel(Board()) as panel:
        for path, headers in (("/", {}), ("/state", {}), ("/nothing", {}), ("/", {"Host": "evil.example"})):
            line = http.client.HTTPConnection("127.0.0.1", panel.port)
            line.request("GET", path, headers={"Authorization": f"Bearer {panel.token}"} | headers)
            given = line.getresponse()
            policy = given.getheader("content-security-policy") or ""
            assert "frame-ancestors 'none'" in policy and "unsafe" not in policy and "default-src 'none'" in policy
            assert given.getheader("x-frame-options") == "DENY" and given.getheader("referrer-policy") == "no-referrer"


def test_other_sites_are_kept_out_on_loopback() -> None:
    with Panel(Board(), page=False) as panel:
        assert asked(panel, "/state", Host="evil.example")[0] == 403
        assert asked(panel, "/stop", "POST", Origin="http://evil.example")[0] == 403
        own = f"http://127.0.0.1:{panel.port}"
        assert asked(panel, "/stop", "POST", Origin=own)[0] == 200
        with pytest.raises(DeviceError, match="another host or port"):
            Panel(Board(), port=panel.port)
