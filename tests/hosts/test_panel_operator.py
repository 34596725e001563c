"""What an operator reads on the page, on a desk and on a phone, by eye, by keyboard and by a screen reader."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from multiprocessing.connection import Listener
from pathlib import Path
from typing import Any

import needs
import pytest
from test_panel import asked
from test_planning import vial

from vamgpu.hosts.panel import Panel, history
from vamgpu.hosts.panel import server as panels
from vamgpu.hosts.process.messages import LIVE, address
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import Board, Estimated, ImageCheck, PrintState, Snapshot, StateChange
from vamgpu.hosts.rig import Rehearsal, carry_out, plan, rehearsal
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.guarantees import guarantees
from vamgpu.printing.scatter import ScatterReading

DOCS = Path(__file__).parents[2] / "docs" / "rigs"
STATIC = Path(panels.__file__).parent / "static"
DESK, PHONE = {"width": 1100, "height": 800}, {"width": 360, "height": 640}
AUDIT = (Path(__file__).parent / "page_audit.js").read_text(encoding="utf-8").partition("\n")[2]
"""What is wrong with a page: names, ids, headings, roles, sizes of what is touched, contrasts, width."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        yield needs.page(tools, viewport=DESK).context.browser


@pytest.fixture
def page(browser: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setattr(panels, "STARTING", 200.0)
    made = browser.new_page(viewport=DESK)
    made.set_default_timeout(needs.WAIT)
    yield made
    made.close()


def claims(rig: str | Path) -> tuple[dict[str, Any], ...]:
    return tuple(one.record() for one in guarantees(read_rig(rig).setup, 40.0))


def busy(**fields: Any) -> Board:
    """A board with everything on it."""
    board = Board(
        state=PrintState.PRINTING, job="boat", slots=720, period=36, slot=90, frame=18, position=90.0, light=True,
        power=0.8, left=75.0, lease=0.25, renewed=0.04, interlock_closed=True, guarantees=claims("emulated"),
        rehearsed=True, plan=2, polled=time.monotonic() + 1e6, parameters=(Estimated("lamp", 0.9, 0.05, (0.5, 1.5)),),
        checks=(ImageCheck("images", 1, 2.0, 15.0), ImageCheck("images", 2, 20.0, 15.0)), doubt=((30, 32), (40, 41)),
        scatter=[ScatterReading(float(k), k / 10, False) for k in range(5)], threshold=0.35, live="doubted",
    )  # fmt: skip
    for name in ("pause", "resume", "cancel"):
        board.button(name, lambda: None)
    board.show(**fields)
    return board


def told(by: Any, name: str) -> str:
    return by(name).inner_text()


def test_turn_time_machine_doubt_and_misfit_are_told(page: Any) -> None:
    by = page.get_by_test_id
    board = busy()
    with Panel(board) as panel:
        page.goto(panel.url)
        by("clock").get_by_text("turn 3 of 20 · 1 min 15 s left").wait_for()
        assert told(by, "in doubt") == "slot 31 to 32, 41: lit for an unknown time"
        assert told(by, "dry run").startswith("DRY RUN") and told(by, "light") == "ON at 80 %, emulated"
        rows = by("machine").get_by_role("row").all()
        known = claims("emulated")
        assert len(rows) == 1 + len(known)
        for row, each in zip(rows[1:], known, strict=True):
            assert row.get_by_role("rowheader").inner_text() == each["about"] and each["why"] in row.inner_text()
        assert (
            page.locator("#checks-plot line.beyond").count() == 1 == page.locator("#checks-plot circle.beyond").count()
        )
        assert "From turn 2 on, the images are not used" in told(by, "checks-reading")
        assert "misfit of the images 20 after turn 2, at most 15" in told(by, "checks-reading")
        bar = page.get_by_role("progressbar")
        assert bar.get_attribute("aria-valuenow") == "13"  # 91 of 720 slots
        board.show(stop=5, checks=board.now.checks[:1], doubt=(), rehearsed=False)
        by("clock").get_by_text("turn 3 of 5").wait_for()
        assert bar.get_attribute("aria-valuenow") == "51" and told(by, "in doubt") == "nothing"
        assert page.locator("#checks-plot .beyond").count() == 0 and by("dry run").is_hidden()
        assert told(by, "light") == "ON at 80 %"
        board.show(period=0, unit="mm", frame=-1, checks=())
        by("clock").get_by_text("1 min 15 s left", exact=True).wait_for()
        assert by("checks").is_hidden() and told(by, "in doubt") == "nothing yet"


def test_a_rig_without_a_controller_claims_no_lease_and_no_interlock(page: Any) -> None:
    by = page.get_by_test_id
    board = busy(guarantees=claims(DOCS / "vialux_zaber.toml"), interlock_closed=None)
    with Panel(board) as panel:
        page.goto(panel.url)
        by("lease").get_by_text("not there: the light may stay on if the host dies").wait_for()
        assert told(by, "interlock") == "not there"
        board.show(guarantees=claims("emulated"))
        by("interlock").get_by_text("not known").wait_for()
        board.show(guarantees=claims(DOCS / "vialux_zaber.toml"))
        by("interlock").get_by_text("not there").wait_for()
        page.route("**/state?page", lambda route: route.abort())
        by("lost").get_by_text("No answer for").wait_for()
        assert "The controller switches the light off" not in told(by, "lost")


@pytest.mark.parametrize("size", [pytest.param(DESK, marks=pytest.mark.slow), PHONE], ids=["desk", "phone"])
def test_every_state_is_readable_named_and_within_the_screen(page: Any, size: Any, tmp_path: Path) -> None:
    past_print(tmp_path / "1.run", PrintState.COMPLETE)
    (tmp_path / "1.run" / "report.html").write_text("")
    page.set_viewport_size(size)
    board = busy()
    with Panel(board, runs=tmp_path) as panel:
        page.goto(panel.url)
        for state in PrintState:
            board.show(
                state=state, deadline=time.monotonic() + 20.0, message="m" * 90, light=state is PrintState.PRINTING
            )
            page.get_by_test_id("state").get_by_text(
                "starting" if state is PrintState.STANDBY else state.value
            ).wait_for()
            page.get_by_role("link", name="report").first.wait_for()
            assert page.evaluate(AUDIT) == [], state
        page.route("**/state?page", lambda route: route.abort())
        page.get_by_test_id("lost").wait_for()
        assert page.evaluate(AUDIT) == [], "lost"
    page.evaluate("document.getElementById('ask').showModal()")
    assert page.evaluate(AUDIT) == [], "asked"


def test_the_audit_finds_what_is_wrong(page: Any) -> None:
    page.set_content("""<style>body { background: #000; color: #555 }</style><h2 role="status">one</h2><button></button>
        <svg></svg><img src="x"><p id="a">two<p id="a">three<div style="width: 5000px">four</div>""")
    text = "\n".join(page.evaluate(AUDIT))
    for part in (
        "no name",
        "stands twice",
        "headings 2",
        "another role",
        "neither named",
        "small to touch",
        "contrast 2.8",
        "pixels wide",
        "only 4",
    ):
        assert part in text, (part, text)


def test_colors_of_the_style_sheet_have_contrast() -> None:
    """Without a browser: each color that a text may have, on each background it may stand on."""
    css = (STATIC / "page.css").read_text(encoding="utf-8")
    named = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", css.partition("html {")[0]))
    texts = {
        *re.findall(r"--hue: (#[0-9a-f]{6})", css),
        *re.findall(r"[ ;]color: (#[0-9a-f]{6})", css),
        named["ink"],
        named["faint"],
    }
    marks = {*re.findall(r"(?:stroke|fill): (#[0-9a-f]{6})", css)}

    def luminance(color: str) -> float:
        parts = (int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
        red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    def contrast(one: str, other: str) -> float:
        high, low = sorted((luminance(one), luminance(other)), reverse=True)
        return (high + 0.05) / (low + 0.05)

    assert contrast("#ffffff", "#000000") == pytest.approx(21.0) and len(texts) > 10 and len(marks) > 3
    for back in (named["room"], named["card"]):
        assert not [color for color in texts if contrast(color, back) < 4.5]
        assert not [color for color in marks if contrast(color, back) < 3.0]
    assert contrast("#ffffff", "#c1121f") >= 4.5, "the stop"
    assert '<meta name="color-scheme" content="dark">' in (STATIC / "page.html").read_text(encoding="utf-8")


def test_a_keyboard_reaches_all_and_cancels_nothing_by_chance(page: Any, tmp_path: Path) -> None:
    past_print(tmp_path / "1.run", PrintState.COMPLETE)
    (tmp_path / "1.run" / "report.html").write_text("")
    board, pressed = busy(), list[str]()
    board.button("cancel", lambda: pressed.append("cancel"))
    at = "(document.activeElement.dataset.testid || document.activeElement.textContent).trim()"
    with Panel(board, runs=tmp_path) as panel:
        page.goto(panel.url)
        page.get_by_role("link", name="report").first.wait_for()
        order = []
        for _ in range(4):
            page.keyboard.press("Tab")
            order.append(page.evaluate(at))
            assert page.evaluate("parseFloat(getComputedStyle(document.activeElement).outlineWidth)") >= 2, order
        assert order == ["stop", "pause", "cancel", "report"], "resume is disabled"
        page.get_by_test_id("cancel").focus()
        page.keyboard.press("Enter")
        assert page.evaluate(at) == "keep", "the first choice keeps the print"
        page.keyboard.press("Escape")
        assert page.get_by_test_id("keep").is_hidden() and not pressed
        page.keyboard.press("Enter")
        page.keyboard.press("Tab")
        with page.expect_response("**/press/cancel"):
            page.keyboard.press("Enter")
        assert pressed == ["cancel"]


def test_who_is_at_a_link_stays_there(page: Any, tmp_path: Path) -> None:
    past_print(tmp_path / "1.run", PrintState.COMPLETE)
    (tmp_path / "1.run" / "report.html").write_text("")
    with Panel(busy(), runs=tmp_path) as panel:
        page.goto(panel.url)
        page.get_by_role("link", name="report").focus()
        page.evaluate("past()")
        assert page.evaluate("document.activeElement.tagName") == "A"


def past_print(place: Path, state: PrintState) -> None:
    with RunFolder.begin(place, {"jobs": ["boat.vam"]}, "") as folder:
        folder.event("segment", 0)
        folder.state(StateChange(PrintState.STANDBY, state, ""))


def test_the_history_knows_which_prints_run(page: Any, tmp_path: Path) -> None:
    for name, state in (("own", "printing"), ("other", "printing"), ("left", "printing"), ("done", "complete")):
        past_print(tmp_path / f"{name}.run", PrintState(state))
    with Listener() as listener, Listener() as closed:
        for name in ("own", "other", "done"):
            (tmp_path / f"{name}.run" / LIVE).write_text(address(listener, b"key"))
        (tmp_path / "left.run" / LIVE).write_text(address(closed, b"key"))
        closed.close()
        found = {each["name"]: each["running"] for each in history.past(tmp_path, "own.run")}
        assert found == {"own.run": False, "other.run": True, "left.run": False, "done.run": False}
        with Panel(busy(rehearsed=False), runs=tmp_path, run="own.run") as panel:
            page.goto(panel.url)
            lines = page.get_by_test_id("history")
            lines.get_by_text("boat.vam: printing (running now)").wait_for()
            assert "vam panel --attach other.run" in lines.inner_text()
            for part in ("printing (this print)", "printing, left by its host", "boat.vam: complete"):
                assert lines.get_by_text(part).count() == 1, part
    for text in ("[]", '{"address": 5}', '{"address": "/nowhere"}', "{", "{}"):
        (tmp_path / "left.run" / LIVE).write_text(text)
        assert not next(each for each in history.past(tmp_path) if each["name"] == "left.run")["running"], text


class SeenBoard(Board):
    """Keeps the snapshots."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Snapshot] = []

    def show(self, **fields: object) -> None:
        super().show(**fields)
        self.seen.append(self.now)


def printed(tmp_path: Path, turns: int = 2, act: Any = None) -> tuple[SeenBoard, Any]:
    planned = plan([vial(tmp_path / "part.vam")], read_rig("emulated"), speed=120, turns=turns, rehearsed=True)
    stand: Rehearsal = rehearsal(planned)
    board = SeenBoard()
    if act is not None:
        show = board.show

        def acts(**fields: object) -> None:
            show(**fields)
            if fields.get("slot", 0) == 40:
                act(stand)

        board.show = acts  # type: ignore[method-assign]
    carry_out(planned, stand.machines, tmp_path / "part.run", board)
    return board, planned


def test_a_print_tells_its_turns_machine_and_time_left(tmp_path: Path) -> None:
    board, planned = printed(tmp_path)
    table = planned.schedule
    assert board.now.period == table.frames and board.now.slots == 2 * table.frames and board.now.rehearsed
    assert list(board.now.guarantees) == read_run(tmp_path / "part.run").asked["guarantees"]
    left = [now.left for now in board.seen if now.left is not None]
    assert left == sorted(left, reverse=True) and left[-1] == pytest.approx(1e-9 * int(table.on[-1]))


def test_a_print_tells_what_is_in_doubt_as_its_record_does(tmp_path: Path) -> None:
    def cut(stand: Rehearsal) -> None:
        stand.emulated.controller.open_interlock(stand.emulated.clock.now())

    board, _ = printed(tmp_path, act=cut)
    run = read_run(tmp_path / "part.run")
    assert run.doubt and tuple(map(tuple, board.now.doubt)) == run.doubt
    (told,) = history.past(tmp_path)
    assert told["doubt"] == sum(stop - first for first, stop in run.doubt) > 0


def test_programs_get_what_the_page_draws() -> None:
    with Panel(busy(), page=False) as panel:
        state = json.loads(asked(panel, "/state")[1])
    assert state["checks"][1] == {"name": "images", "turn": 2, "value": 20.0, "limit": 15.0}
    assert state["doubt"] == [[30, 32], [40, 41]] and state["rehearsed"] and state["period"] == 36
    assert state["guarantees"] == json.loads(json.dumps(claims("emulated")))
