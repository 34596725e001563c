"""The live page of a print: what it shows, how it does, buttons, and a stop. Needs the extra ``panel``."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np

from vamgpu.errors import DeviceError, VamError
from vamgpu.hosts.board import Board, Snapshot

PERIOD = 0.2
"""Seconds between two looks of a page at the print."""
WIDTH = 480
"""Pixels of the picture's longer side on the page."""


def rows(now: Snapshot) -> dict[str, str]:
    """What the page says, by the name it says it under."""
    done = f" of {now.slots}" if now.slots else ""
    return {
        "state": now.state.value + (f": {now.message}" if now.message else ""),
        "light": f"ON at {now.power:.4g}" if now.light else "off",
        "frame": f"{now.frame} (slot {now.slot}{done})",
        "position": f"{now.position:.3f} {now.unit}",
        "focus": "—" if now.focus is None else f"{now.focus:+.3f} dpt",
        "buffer": f"{100 * now.fill:.0f} % full",
        "timing margin": f"{now.margin / 1e6:.2f} ms",
        "shown black": str(now.dark),
        "dose": f"{100 * now.spent:.1f} % of the plan",
    }


def serve_page(app: Any, board: Board) -> None:
    """Add the page to an application. Raises `DeviceError` where this process has served it before."""
    from nicegui import app as served
    from nicegui import ui

    if served.middleware_stack is not None:
        raise DeviceError("this process has served the page before; begin the next print in a process of its own")

    @ui.page("/")
    def page() -> None:
        _page(ui, board)

    ui.run_with(app, title="vamgpu", dark=True, show_welcome_message=False, reconnect_timeout=3.0)


def _page(ui: Any, board: Board) -> None:
    """One browser's page."""
    ui.button("EMERGENCY STOP", on_click=lambda: board.stop("emergency stop at the panel"), color="red").classes(
        "w-full text-2xl py-6"
    ).mark("stop").props('data-testid="stop"')
    ui.label(board.now.job).classes("text-lg")
    with ui.row():
        picture = ui.image().style(f"width: {WIDTH}px; background: black; image-rendering: pixelated")
        picture.props('data-testid="picture" no-transition no-spinner')
        with ui.grid(columns="auto 1fr").classes("gap-x-6 text-lg"):
            values = {}
            for name in rows(board.now):
                ui.label(name).classes("opacity-60")
                values[name] = ui.label().props(f'data-testid="{name}"')
    offered, buttons = ui.row(), {}
    shown: list[Any] = [None]

    def refresh() -> None:
        now = board.now
        for name, text in rows(now).items():
            values[name].set_text(text)
        values["light"].style("color: #fd6" if now.light else "color: inherit")
        for name in board.buttons:  # a page may be opened before the print that offers them begins
            if name not in buttons:
                with offered:
                    press = ui.button(name, on_click=lambda name=name: _press(ui, board.buttons[name]))
                buttons[name] = press.props(f'data-testid="{name}"')
        for button in buttons.values():
            button.set_enabled(not now.state.ended)
        if now.picture is not None and now.picture is not shown[0]:
            shown[0] = now.picture
            picture.set_source(data_url(now.picture))

    refresh()
    ui.timer(PERIOD, refresh)


def _press(ui: Any, press: Any) -> None:
    try:
        press()
    except VamError as error:
        ui.notify(str(error), type="warning")


def data_url(picture: np.ndarray) -> str:
    """A picture as a page takes it, thinned out to the page's size."""
    from PIL import Image

    step = max(1, -(-max(picture.shape) // WIDTH))
    kept = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture[::step, ::step])).save(kept, "PNG", compress_level=1)
    return "data:image/png;base64," + base64.b64encode(kept.getvalue()).decode()
