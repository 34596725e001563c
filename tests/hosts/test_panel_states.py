"""The live page in every state of emulated prints, at the width of a desk and of a phone.

The pictures stay where the environment variable VAMGPU_PAGES says, to be looked at.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import needs
import pytest
from test_planning import vial, web

from vamgpu.errors import VamError
from vamgpu.hosts.panel import Panel
from vamgpu.hosts.records.state import Board, PrintState, Snapshot
from vamgpu.hosts.rig import carry_out, plan, rehearsal
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.planning import PrintPlan

pytestmark = pytest.mark.slow
WIDTHS = {"desk": (1100, 760), "phone": (390, 844)}


class FilmedBoard(Board):
    """A board whose print stands still, as its time does, while an act looks at it. ``acts`` follow one another."""

    def __init__(self, **fields: object) -> None:
        super().__init__(**fields)
        self.acts: list[tuple[Callable[[Snapshot], bool], Callable[[], object]]] = []
        self._prints = threading.get_ident()

    def show(self, **fields: object) -> None:
        if "polled" in fields:
            fields["polled"] = time.monotonic() + 1e6  # never old news: only emulated time stands still
        super().show(**fields)
        if threading.get_ident() == self._prints and self.acts and self.acts[0][0](self.now):
            self.acts.pop(0)[1]()

    def at(self, state: PrintState, act: Callable[[], object], slot: int = 0, **fields: object) -> None:
        self.acts.append(
            (lambda now: now.state is state and now.slot >= slot and fields.items() <= vars(now).items(), act)
        )

    def press(self, name: str) -> Callable[[], None]:
        return lambda: self.buttons[name]()


DECODED = """async (image) => {
  for (let tries = 0; tries < 100; tries++) {
    try { return await image.decode(); } catch (error) { await new Promise((next) => setTimeout(next, 100)); }
  }
  return image.decode();
}"""
"""Waits until an image is drawn; one that a later image replaces while it loads is tried again."""


class Film:
    """A print on emulated machines, and its page at both widths."""

    def __init__(self, planned: PrintPlan, folder: Path, pages: dict[str, Any], out: Path) -> None:
        self.planned, self.folder, self.pages, self.out = planned, folder, pages, out
        self.board = FilmedBoard(job=" ".join(Path(job.path).name for job in planned.jobs))
        self.emulated: Any = None

    def print(self) -> None:
        """To its end, on machines that stop with their clock."""
        stand = rehearsal(self.planned)
        self.emulated = stand.emulated
        with suppress(VamError):
            carry_out(self.planned, stand.machines, self.folder, self.board)
        assert not self.board.acts, "all was seen"

    def shot(self, name: str, *told: str, projectors: int = 0) -> None:
        """Draw the page; it says its state and what is told, and nothing is out of reach."""
        for width, page in self.pages.items():
            page.get_by_test_id("state").get_by_text(name.split("-")[0]).wait_for()
            for text in told:
                page.get_by_text(text).first.wait_for()
            for number in range(projectors):
                image = page.get_by_test_id(f"projector {number + 1}")
                image.wait_for()
                image.evaluate(DECODED)
            page.screenshot(path=self.out / f"{name}-{width}.png")
            page.screenshot(path=self.out / f"{name}-{width}-whole.png", full_page=True)
            size = page.viewport_size
            assert page.evaluate("document.documentElement.scrollWidth") <= size["width"], (name, width)
            stop = page.get_by_test_id("stop").bounding_box()
            assert 0 <= stop["y"] <= stop["y"] + stop["height"] <= size["height"], (name, width)


@pytest.fixture(scope="module")
def pages() -> Iterator[dict[str, Any]]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        desk = needs.page(tools)
        yield {
            name: desk.context.browser.new_page(viewport={"width": width, "height": height})
            for name, (width, height) in WIDTHS.items()
        }


@pytest.fixture
def filmed(tmp_path: Path, pages: dict[str, Any]) -> Iterator[Callable[..., Film]]:
    """A film of jobs, whose page is open until the test ends."""
    out = Path(os.environ.get("VAMGPU_PAGES", tmp_path))
    out.mkdir(parents=True, exist_ok=True)
    panels: list[Panel] = []

    def made(*jobs: Path, **options: Any) -> Film:
        planned = plan(jobs, read_rig("emulated"), rehearsed=True, **options)
        film = Film(planned, tmp_path / "part.run", pages, out)
        panels.append(Panel(film.board, runs=tmp_path, run="part.run").__enter__())
        for page in pages.values():
            page.set_default_timeout(needs.WAIT)
            page.goto(panels[-1].url)
        return film

    yield made
    for panel in panels:
        panel.__exit__(None, None, None)


def test_a_vial_that_is_paused_and_complete(tmp_path: Path, filmed: Callable[..., Film]) -> None:
    film = filmed(vial(tmp_path / "part.vam"), speed=120, turns=4)
    board = film.board
    film.shot("standby")
    board.at(PrintState.STANDBY, lambda: film.shot("starting", "closed"), interlock_closed=True)
    board.at(PrintState.PRINTING, lambda: film.shot("printing-vial", "ON at", projectors=1), 40)
    board.at(PrintState.PRINTING, board.press("pause"), 41)
    board.at(PrintState.PAUSED, lambda: film.shot("paused", "can continue for"))
    board.at(PrintState.PAUSED, board.press("resume"))
    board.at(PrintState.PAUSED, lambda: film.shot("starting-again", "then the light turns on"), resuming=True)
    film.print()
    film.shot("complete", "none: the print has ended", "part.run")


def test_a_vial_whose_door_is_opened_ends_incomplete(tmp_path: Path, filmed: Callable[..., Film]) -> None:
    film = filmed(vial(tmp_path / "part.vam"), speed=120, turns=2)
    board = film.board
    board.at(PrintState.PRINTING, lambda: film.emulated.controller.open_interlock(film.emulated.clock.now()), 30)
    board.at(
        PrintState.HELD,
        lambda: film.shot("held-open", "Close the enclosure, then press resume", "can continue for"),
        interlock_closed=False,
    )
    board.at(PrintState.HELD, lambda: setattr(film.emulated.controller, "interlock_closed", True))
    board.at(PrintState.HELD, lambda: film.shot("held-closed", "press resume"), interlock_closed=True)
    board.at(PrintState.HELD, board.press("resume"))
    film.print()
    film.shot("incomplete")


def test_a_web_that_is_cancelled(tmp_path: Path, filmed: Callable[..., Film]) -> None:
    film = filmed(web(tmp_path / "web.vam"), speed=0.8)
    board = film.board
    board.at(PrintState.PRINTING, lambda: film.shot("printing-web", "dpt", "°C", projectors=1), 20)
    board.at(PrintState.PRINTING, lambda: board.stop("emergency stop at the panel"), 21)
    film.print()
    film.shot("cancelled", "emergency stop at the panel")


def test_two_colors_that_end_with_an_error(tmp_path: Path, filmed: Callable[..., Film]) -> None:
    film = filmed(vial(tmp_path / "visible.vam"), vial(tmp_path / "uv.vam", 5), speed=120, turns=2)
    board = film.board
    board.at(PrintState.PRINTING, lambda: film.shot("printing-two", projectors=2), 30)
    board.at(PrintState.PRINTING, lambda: film.emulated.controller.lose_power(film.emulated.clock.now()), 31)
    film.print()
    film.shot("error", "start again with fresh resin")


def test_a_page_that_lost_its_server(tmp_path: Path, filmed: Callable[..., Film]) -> None:
    film = filmed(vial(tmp_path / "part.vam"), speed=120, turns=1)
    board = film.board

    def lost() -> None:
        for page in film.pages.values():
            page.get_by_test_id("light").get_by_text("ON at").wait_for()
            page.route("**/state?page", lambda route: route.abort())
        film.shot("connection lost", "No answer for")
        for page in film.pages.values():
            page.unroute("**/state?page")
        film.shot("printing-again", "ON at")

    board.at(PrintState.PRINTING, lost, 20)
    film.print()
