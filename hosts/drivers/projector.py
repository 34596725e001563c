"""Projectors used as a screen: a full-screen window, and frames in the slots of its video frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from vamgpu.errors import BadInput, DeviceLost, DeviceNotFound, VamError, WrongDevice
from vamgpu.hosts.drivers.cleanup import ClosedOnce, closed_on_error, extra


@dataclass(frozen=True)
class SlotLayout:
    """Channels of a video frame for the frames, in the order in which they are shown."""

    channels: tuple[int, ...]  # 0 red, 1 green, 2 blue
    bits: int  # fewer than 8 use the high bits
    gray: bool = False  # all channels carry the one frame

    @property
    def slots(self) -> int:
        """Frames per video frame."""
        return len(self.channels)


TWO_OF_8 = SlotLayout((1, 0), 8)
THREE_OF_7 = SlotLayout((1, 0, 2), 7)
ONE_GRAY = SlotLayout((1,), 8, gray=True)


def compose(frames: list[np.ndarray], layout: SlotLayout) -> np.ndarray:
    """Compose a video frame ``[row, column, 3]`` of 8-bit frames; level 255 becomes 127 for 7 bits."""
    if len(frames) != layout.slots:
        raise BadInput(f"{len(frames)} frames for the {layout.slots} slots of a video frame")
    shape = frames[0].shape
    video_frame = np.zeros((*shape, 3), np.uint8)
    for channel, frame in zip(layout.channels, frames, strict=True):
        if frame.dtype != np.uint8 or frame.shape != shape:
            raise BadInput(f"got a frame of {frame.dtype}{list(frame.shape)}; expected uint8 frames of one shape")
        if layout.bits == 8:
            video_frame[..., channel] = frame
        else:
            top = 2**layout.bits - 1
            levels = (frame.astype(np.uint16) * top + 127) // 255
            video_frame[..., channel] = levels << (8 - layout.bits)
    return np.repeat(video_frame[..., layout.channels], 3, axis=2) if layout.gray else video_frame


@runtime_checkable
class Window(Protocol):
    """A full screen of rows and columns, refreshed ``rate_hz`` times per second."""

    size: tuple[int, int]
    rate_hz: float

    # show ``[row, column, 3]`` (uint8) from the next refresh on; returns the number of that refresh
    def show(self, video_frame: np.ndarray, /) -> int: ...
    def close(self) -> None: ...  # show black, and close


class PygletWindow:
    """A pyglet window on one screen, in step with its refresh, without scaling."""

    def __init__(self, screen: int, size: tuple[int, int], rate_hz: float | None = None) -> None:
        with extra("window", "a projector window needs pyglet"):
            import pyglet  # type: ignore[import-not-found]
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
            raise WrongDevice(f"the system does not report the refresh rate of screen {screen}; set its rate_hz")
        self.size = size
        self.rate_hz: float = float(rate)
        self._pyglet: Any = pyglet
        self._window: Any = pyglet.window.Window(fullscreen=True, screen=found, vsync=True)
        self._window.set_mouse_visible(False)
        self._refresh = 0
        with closed_on_error(self._window):
            self.show(np.zeros((*size, 3), np.uint8))

    def show(self, video_frame: np.ndarray, /) -> int:
        rows, columns = self.size
        if self._window.has_exit:
            raise DeviceLost("the projector's window was closed; leave it open while a print runs")
        image = self._pyglet.image.ImageData(columns, rows, "RGB", video_frame.tobytes(), pitch=-3 * columns)
        self._window.switch_to()
        self._window.dispatch_events()
        image.blit(0, 0)
        self._window.flip()
        self._refresh += 1
        return self._refresh

    def close(self) -> None:
        """Show black and close; closes even if it cannot show black."""
        try:
            self.show(np.zeros((*self.size, 3), np.uint8))
        finally:
            self._window.close()


class HdmiProjector(ClosedOnce):
    """A projector that shows several frames of each video frame, ``latency`` refreshes after it was sent."""

    called = "the projector's window (check its cable and its power)"  # lost, it is dark

    def __init__(self, window: Window, layout: SlotLayout, latency_refreshes: int = 1) -> None:
        self.window = window
        self.layout = layout
        self.latency = latency_refreshes

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.window.size

    @property
    def slots_per_s(self) -> float:
        return self.layout.slots * self.window.rate_hz

    def show(self, frames: list[np.ndarray]) -> int:
        """Show the next video frame's frames ``[row, column]``; returns the number of their first slot."""
        if any(frame.shape != self.size for frame in frames):
            raise BadInput(f"frames must have {self.size[0]} x {self.size[1]} pixels, as the projector has")
        refresh = self._send(compose(frames, self.layout))
        return (refresh + self.latency) * self.layout.slots

    def black(self) -> None:
        """Show black. The light ends some refreshes later; if that is too late, switch the lamp off."""
        self._send(np.zeros((*self.size, 3), np.uint8))

    def _send(self, video_frame: np.ndarray) -> int:
        try:
            return self.window.show(video_frame)
        except VamError:
            raise
        except Exception as error:  # systems raise various errors for an unplugged screen
            raise DeviceLost(f"the projector's screen is lost ({error}); check its cable and its power") from error

    def endings(self) -> tuple[Callable[[], object], ...]:
        return (self.window.close,)
