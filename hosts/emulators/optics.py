"""What a camera and a photodiode see of emulated mirrors: through a lens that focuses somewhere, past a roller.

Everything is integrated from when planes truly stood and the lamp truly shone; nothing of what a host wanted is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MICRO = 1000
FAINT = 1e-15


@dataclass(frozen=True)
class Optics:
    """The truth that calibrations look for.

    slope, middle: focus at middle + slope · power [mm/dpt], [mm], from the middle of the camera's stage.  waist: blur
    in focus, a standard deviation [mm].  depth: from where to where it is √2 times as wide [mm].  mirrors: rows and
    columns.  pitch: of a mirror in the picture [mm].  view: rows and columns of the camera.  electrons: a pixel and
    second in full light.  axis, radius, shadow: of the roller, and its edges' blur [columns].  leak: light of a mirror
    that is off, over one that is on.  turn: dark time at the begin of each plane [us].  full: light of all mirrors on
    the photodiode [mW].  ambient, noise: on it [mW].  seed: of all noise.
    """

    slope: float = -40.6
    middle: float = 0.35
    waist: float = 0.0138
    depth: float = 3.8
    mirrors: tuple[int, int] = (96, 192)
    pitch: float = 0.0144
    view: tuple[int, int] = (104, 208)
    electrons: float = 4.0e6
    axis: float = 98.3
    radius: float = 55.2
    shadow: float = 1.3
    leak: float = 0.002
    turn: float = 4.0
    full: float = 20.0
    ambient: float = 0.02
    noise: float = 0.001
    seed: int = 0

    def blur(self, position: float, power: float) -> float:
        """Standard deviation [mm] of the blur at a camera's position [mm] and a lens power [dpt]."""
        off = position - self.middle - self.slope * power
        return self.waist * float(np.hypot(1.0, 2.0 * off / self.depth))

    def modulation(self, frequency: np.ndarray, position: float, power: float, pixel: float) -> np.ndarray:
        """Modulation at frequencies [1/mm]: of the blur, the mirrors and the camera's pixels."""
        gauss = np.exp(-2.0 * (np.pi * self.blur(position, power) * frequency) ** 2)
        return gauss * np.sinc(frequency * self.pitch) * np.sinc(frequency * pixel)

    def gray(self, level: int, lit: int) -> float:
        """Light of a gray level over that of mirrors that always are on; ``lit``: time of a picture [us]."""
        planes = [lit * (1 << bit) / 255.0 - self.turn for bit in range(8) if level >> bit & 1]
        return self.leak + (1.0 - self.leak) * sum(planes) / lit

    def passes(self) -> np.ndarray:
        """Share of a column's light that the roller lets by."""
        from scipy.special import ndtr

        column = np.arange(self.mirrors[1])
        left = ndtr((self.axis - self.radius - column) / self.shadow)
        return left + ndtr((column - self.axis - self.radius) / self.shadow)

    def spread(self, mirrors: int, pixels: int, pixel: float, blur: float) -> np.ndarray:
        """Weights [pixel, mirror] of one axis: a mirror's width, blurred, as a pixel's width sees it; exact."""
        edge = (np.arange(mirrors + 1) - 0.5 * mirrors) * self.pitch
        border = (np.arange(pixels + 1) - 0.5 * pixels) * pixel
        area = _ramp((border[:, None] - edge[None, :]) / blur) * blur
        weights = -np.diff(np.diff(area, axis=0), axis=1) / pixel
        return np.where(weights > FAINT, weights, 0.0)  # subnormal numbers would cost more than all others

    def image(self, light: np.ndarray, pixel: float, blur: float) -> np.ndarray:
        """What the camera sees of light on the mirrors [row, column]: electrons a second."""
        down, across = (self.spread(light.shape[axis], self.view[axis], pixel, blur) for axis in (0, 1))
        return self.electrons * (down @ light @ across.T)


def _ramp(u: np.ndarray) -> np.ndarray:
    """Integral of the normal distribution up to u."""
    from scipy.special import ndtr

    return u * ndtr(u) + np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi)


def box(share: np.ndarray) -> np.ndarray:
    """Weight, up to a share of an exposure, of what comes in it: all the same."""
    return share


def smooth(share: np.ndarray) -> np.ndarray:
    """Weight, up to a share of its memory, of what a slow meter has seen: rising and falling softly."""
    return share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi)
