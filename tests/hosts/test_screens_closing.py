"""A projector's window is let go of once, whatever has become of its screen, and hides no other error."""

from __future__ import annotations

import logging
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import DeviceLost, DeviceNotFound
from vamgpu.hosts.drivers.projector import TWO_OF_8, HdmiProjector, PygletWindow

SIZE: tuple[int, int] = (4, 5)


class GlError(Exception):
    """What graphics raise."""


class Window:
    """A window whose screen may be pulled out."""

    size: tuple[int, int] = SIZE
    rate_hz: float = 60.0

    def __init__(self) -> None:
        self.closed, self.lost = 0, False

    def show(self, frame: np.ndarray) -> int:
        self._screen()
        return 1

    def close(self) -> None:
        self.closed += 1
        self._screen()

    def _screen(self) -> None:
        if self.lost:
            raise GlError("invalid operation")


def test_a_window_is_closed_once() -> None:
    window = Window()
    projector = HdmiProjector(window, TWO_OF_8)
    with projector:
        projector.black()
    projector.close()
    assert window.closed == 1


def test_a_lost_screen_hides_no_reason(caplog: pytest.LogCaptureFixture) -> None:
    window = Window()
    projector = HdmiProjector(window, TWO_OF_8)
    with caplog.at_level(logging.WARNING), pytest.raises(ZeroDivisionError), projector:
        window.lost = True
        raise ZeroDivisionError("why the print ended")
    assert window.closed == 1 and "invalid operation" in caplog.text and "check its cable" in caplog.text
    projector.close()
    assert window.closed == 1
    with pytest.raises(DeviceLost, match="invalid operation"):
        projector.black()


class Pyglet:
    """As much of the package as a window takes; graphics fail after ``flips`` frames."""

    def __init__(self, flips: int) -> None:
        self.flips, self.closed, self.shown = flips, 0, 0
        found = SimpleNamespace(height=SIZE[0], width=SIZE[1], get_mode=lambda: SimpleNamespace(rate=60))
        self.display = SimpleNamespace(get_display=lambda: SimpleNamespace(get_screens=lambda: [found]))
        self.window = SimpleNamespace(Window=lambda **_: self)
        self.image = SimpleNamespace(ImageData=lambda *_, **__: SimpleNamespace(blit=lambda x, y: None))
        self.has_exit = False

    def set_mouse_visible(self, visible: bool) -> None: ...
    def switch_to(self) -> None: ...
    def dispatch_events(self) -> None: ...

    def flip(self) -> None:
        if self.shown == self.flips:
            raise GlError("context lost")
        self.shown += 1

    def close(self) -> None:
        self.closed += 1


def opened(monkeypatch: pytest.MonkeyPatch, flips: int) -> tuple[Pyglet, Any]:
    pyglet = Pyglet(flips)
    monkeypatch.setitem(sys.modules, "pyglet", pyglet)  # type: ignore[arg-type]
    return pyglet, lambda screen=0: PygletWindow(screen, SIZE)


def test_a_window_goes_away_though_it_cannot_go_dark(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pyglet, window = opened(monkeypatch, 1)
    projector = HdmiProjector(window(), TWO_OF_8)
    projector.close()
    assert pyglet.closed == 1 and "context lost" in caplog.text
    pyglet, window = opened(monkeypatch, 5)
    HdmiProjector(window(), TWO_OF_8).close()
    assert pyglet.closed == 1 and pyglet.shown == 2, "black at first and at last"


def test_a_window_that_shows_nothing_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    pyglet, window = opened(monkeypatch, 0)
    with pytest.raises(GlError):
        window()
    assert pyglet.closed == 1
    for screen in (-1, 1):
        with pytest.raises(DeviceNotFound, match="no screen"):
            window(screen)
