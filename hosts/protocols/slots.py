"""Several pictures in one video frame: the controller shows a frame's 24 bit planes as pictures one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput


@dataclass(frozen=True)
class SlotLayout:
    """Which channel of a frame carries which picture, in the order they are shown, and with how many bits.

    ``channels`` are 0 red, 1 green, 2 blue; pictures of fewer than 8 bits lie in the high bits.
    """

    channels: tuple[int, ...]
    bits: int

    @property
    def slots(self) -> int:
        """Pictures a frame."""
        return len(self.channels)


TWO_OF_8 = SlotLayout((1, 0), 8)
THREE_OF_7 = SlotLayout((1, 0, 2), 7)
ONE_OF_8 = SlotLayout((1,), 8)


def compose(pictures: list[np.ndarray], layout: SlotLayout) -> np.ndarray:
    """A frame ``[row, column, 3]`` (uint8) of as many 8-bit pictures ``[row, column]`` as the layout holds.

    Levels are rounded to the layout's bits; where it holds 7, level 255 becomes 127 of 127.
    """
    if len(pictures) != layout.slots:
        raise BadInput(f"{len(pictures)} pictures for the {layout.slots} slots of a frame")
    shape = pictures[0].shape
    frame = np.zeros((*shape, 3), np.uint8)
    for channel, picture in zip(layout.channels, pictures, strict=True):
        if picture.dtype != np.uint8 or picture.shape != shape:
            raise BadInput(f"pictures of a frame are uint8 of one shape, not {picture.dtype}{list(picture.shape)}")
        if layout.bits == 8:
            frame[..., channel] = picture
        else:
            top = 2**layout.bits - 1
            levels = (picture.astype(np.uint16) * top + 127) // 255
            frame[..., channel] = levels << (8 - layout.bits)
    return frame


def plane_walk(shape: tuple[int, int]) -> list[np.ndarray]:
    """Frames ``[row, column, 3]`` that light one of the 24 bit planes each: green, red, blue, and low bits first.

    On a screen of the right setting, 24 equal flashes follow one another; a dead or doubled plane shows at once.
    """
    frames = []
    for channel in (1, 0, 2):
        for bit in range(8):
            frame = np.zeros((*shape, 3), np.uint8)
            frame[..., channel] = 1 << bit
            frames.append(frame)
    return frames
