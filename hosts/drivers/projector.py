"""Projectors that are a screen: a window that covers it, and pictures in the slots of its frames."""

from __future__ import annotations

import logging
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from vamgpu.errors import BadInput, DeviceLost, DeviceNotFound, VamError, WrongDevice
from vamgpu.hosts.protocols.slots import SlotLayout, compose

log = logging.getLogger(__name__)


@runtime_checkable
class Window(Protocol):
    """A full screen of rows and columns, refreshed ``rate_hz`` times a second."""

    size: tuple[int, int]
    rate_hz: float

    def show(self, frame: np.ndarray, /) -> int:
        """Show ``[row, column, 3]`` (uint8) from the next refresh on; returns the number of that refresh."""
        ...

    def close(self) -> None:
        """Go dark, and away."""
        ...


class PygletWindow:
    """A window of the pyglet package on one screen, in step with its refresh, without scaling.

    ``rate_hz`` is needed where the system does not tell the screen's.
    """

    def __init__(self, screen: int, size: tuple[int, int], rate_hz: float | None = None) -> None:
        try:
            import pyglet  # type: ignore[import-not-found]
        except ImportError as error:
            raise DeviceNotFound('a projector window needs pyglet: pip install "vamgpu[window]"') from error
        try:
            screens = pyglet.display.get_display().get_screens()
        except Exception as error:
            raise DeviceNotFound(
                f"there is no display to open a window on ({error}); start one, or set DISPLAY"
            ) from error
        if not 0 <= screen < len(screens):
            raise DeviceNotFound(f"there is no screen {screen}, only {len(screens)}; check the projector's cable")
        found = screens[screen]
        if (found.height, found.width) != size:
            raise WrongDevice(
                f"screen {screen} has {found.height} x {found.width} pixels, the projector {size[0]} x {size[1]}; "
                "set its native resolution and no scaling"
            )
        rate = rate_hz or getattr(found.get_mode(), "rate", None)
        if not rate:
            raise WrongDevice(f"the system does not tell how often screen {screen} is refreshed; configure its rate_hz")
        self.size, self.rate_hz = size, float(rate)
        self._pyglet: Any = pyglet
        self._window: Any = pyglet.window.Window(fullscreen=True, screen=found, vsync=True)
        self._window.set_mouse_visible(False)
        self._refresh = 0
        try:
            self.show(np.zeros((*size, 3), np.uint8))
        except BaseException:
            self._window.close()
            raise

    def show(self, frame: np.ndarray, /) -> int:
        """Show a frame from the next refresh on; returns when it is on the screen."""
        rows, columns = self.size
        if self._window.has_exit:
            raise DeviceLost("the projector's window was closed; leave it open while a print runs")
        image = self._pyglet.image.ImageData(columns, rows, "RGB", frame.tobytes(), pitch=-3 * columns)
        self._window.switch_to()
        self._window.dispatch_events()
        image.blit(0, 0)
        self._window.flip()
        self._refresh += 1
        return self._refresh

    def close(self) -> None:
        """Go dark, and away, which it does though it cannot go dark."""
        try:
            self.show(np.zeros((*self.size, 3), np.uint8))
        finally:
            self._window.close()


class HdmiProjector:
    """Pictures on a projector that shows several of them each frame.

    A controller in video pattern mode shows a frame one refresh after it has received it; ``latency_refreshes`` says
    how many, so that ``show`` can tell when the light of its pictures comes.
    """

    def __init__(self, window: Window, layout: SlotLayout, latency_refreshes: int = 1) -> None:
        self.window, self.layout, self.latency = window, layout, latency_refreshes
        self._closed = False

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.window.size

    @property
    def slots_per_s(self) -> float:
        """Pictures a second."""
        return self.layout.slots * self.window.rate_hz

    def show(self, pictures: list[np.ndarray]) -> int:
        """Show the next frame's pictures ``[row, column]`` (uint8); the number of the first slot they are lit in.

        Raises `DeviceLost` where the screen is gone.
        """
        if any(picture.shape != self.size for picture in pictures):
            raise BadInput(f"pictures must have {self.size[0]} x {self.size[1]} pixels, as the projector has")
        refresh = self._send(compose(pictures, self.layout))
        return (refresh + self.latency) * self.layout.slots

    def black(self) -> None:
        """Show black; light ends some refreshes later, so switch the lamp off where that is too late."""
        self._send(np.zeros((*self.size, 3), np.uint8))

    def _send(self, frame: np.ndarray) -> int:
        try:
            return self.window.show(frame)
        except VamError:
            raise
        except Exception as error:  # whatever a system raises for a screen that was pulled out
            raise DeviceLost(f"the projector's screen is gone ({error}); check its cable and its power") from error

    def close(self) -> None:
        """Go dark, and away; more than once does no harm. That a screen is lost is logged: it is dark."""
        if self._closed:
            return
        self._closed = True
        try:
            self.window.close()
        except Exception as error:  # raised, it would hide why a print ended
            log.warning("closing the projector's window: %s; check its cable and its power", error)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
