"""Limits of a web machine: sampling, speed, data, angles, flow. Only formulas, no simulation.

Source: J. Toombs et al., "Roll-to-roll tomographic volumetric additive manufacturing", sections S10 to S14.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf, pi

import numpy as np

from vamgpu.geometry import Beam, positive
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.printing.focus import FocusMasks, bins_needed
from vamgpu.quantity import counted
from vamgpu.schema import check
from vamgpu.schema.quantities import Density, Length, Speed, Viscosity
from vamgpu.units import kg_m3
from vamgpu.webs.display import Display

GRAVITY = 9806.65  # standard acceleration of free fall [mm/s²]


@dataclass(frozen=True)
class SpeedLimit:
    """The greatest speed [mm/s] of the web that one part of the machine allows."""

    name: str
    speed: float
    reason: str


@dataclass(frozen=True)
class WebLimits:
    """The limits of a web machine at one speed. Raises `BadInput`, also if the lens cannot focus on the film."""

    roller: Roller  # with its film
    lens: TunableLens = TunableLens()  # with its depth bins and settling time
    display: Display = Display()  # the mirrors
    speed: Speed = 0.8  # of the web's neutral line [mm/s]
    length: Length = 600.0  # of the web to print [mm]
    depth_of_focus: Length = 3.8  # of the projector [mm]
    density: Density = 1100.0 * kg_m3  # of the uncured resin [mJ·s²/mm⁵]; write ``1100 * units.kg_m3``
    viscosity: Viscosity | None = None  # its dynamic viscosity [mJ·s/mm³], written as ``40 * units.Pa_s``

    def __post_init__(self) -> None:
        check(self)
        self.lens.power(np.array(self.masks.planes))

    @cached_property
    def masks(self) -> FocusMasks:
        """Focus planes of the lens for the columns that meet the film."""
        film = self.roller.film
        return FocusMasks.around(self.beam, self.roller.radius, film.thickness, self.lens.bins)

    @cached_property
    def beam(self) -> Beam:
        """The columns of the mirrors that meet the film."""
        whole = self.roller.beam(self.display.pitch, 1).pixels[0]
        return Beam((min(whole, self.display.pixels[0]), self.display.pixels[1]), self.display.pitch)

    @property
    def advance(self) -> float:
        """Advance of the web from one angle to the next [mm], along its neutral line."""
        return self.roller.advance

    @property
    def tangential_sampling(self) -> float:
        """Angles per length of the web [1/mm] (S18)."""
        return 1.0 / self.advance

    @property
    def pose_rate(self) -> float:
        return self.speed / self.advance

    @property
    def frame_rate(self) -> float:
        """Frames per second: every angle has one frame for each depth bin."""
        return self.lens.bins * self.pose_rate

    @property
    def slot(self) -> float:
        """Seconds from one frame to the next."""
        return 1.0 / self.frame_rate

    @property
    def data_rate(self) -> float:
        """Bytes per second."""
        return self.frame_rate * self.display.nbytes

    @property
    def poses(self) -> float:
        """Number of angles while the length passes one point."""
        return self.length / self.advance

    @property
    def frames(self) -> float:
        """Number of frames while the length passes one point."""
        return self.lens.bins * self.poses

    @property
    def duty(self) -> float:
        """Share of the time in which the lens is idle and light can be on; negative if too fast."""
        return 1.0 - self.moves * (self.display.wire + self.lens.settle) * self.pose_rate

    @property
    def nbytes(self) -> float:
        """Bytes of all frames of the length."""
        return self.frames * self.display.nbytes

    @property
    def smear(self) -> float:
        """Advance [mm] of the web during one frame."""
        return self.speed * self.slot

    @property
    def moves(self) -> int:
        """Number of lens moves per angle."""
        bins = self.lens.bins
        return 0 if bins == 1 else bins - 1 if self.display.turning else bins

    def sampling_limit(self, speed: float) -> float:
        """Largest number of angles per length of a web [1/mm] at a speed [mm/s] that the lens allows: f/(M·v) (S20)."""
        busy = self.moves * self.lens.settle
        return inf if busy == 0 else 1.0 / (busy * positive("speed [mm/s]", speed))

    @property
    def pose_time(self) -> float:
        """Least time per angle [s]: each lens move is commanded and settles, then its frame is shown."""
        return self.moves * (self.display.wire + self.lens.settle) + self.lens.bins / self.display.rate

    @cached_property
    def speeds(self) -> tuple[SpeedLimit, ...]:
        """The greatest speed that each part allows by itself, and that of all of them in sequence (S17–S20)."""
        shown, bins, moves = self.display, self.lens.bins, self.moves
        frames = f"{counted(bins, 'frame')} an angle"
        parts = {
            "mirrors": (bins / shown.rate, f"{frames} at {shown.rate:g} Hz"),
            "lens": (moves * self.lens.settle, f"{moves} moves an angle of {1e3 * self.lens.settle:.3g} ms"),
            "serial line": (moves * shown.wire, f"{moves} commands an angle of {1e3 * shown.wire:.3g} ms"),
        }
        longest = max(parts, key=lambda name: parts[name][0])
        share = f"{100 * parts[longest][0] / self.pose_time:.0f} % of them for the {longest}"
        parts["all in turn"] = (self.pose_time, f"{1e3 * self.pose_time:.3g} ms an angle, {share}")
        parts["data link"] = (bins * shown.nbytes / shown.link, f"{frames} of {shown.nbytes:,} bytes")
        return tuple(
            SpeedLimit(name, inf if time == 0 else self.advance / time, reason)
            for name, (time, reason) in parts.items()
        )

    @property
    def limiting(self) -> SpeedLimit:
        """The lowest of these limits."""
        return min(self.speeds, key=lambda limit: limit.speed)

    @property
    def slowest(self) -> float:
        """Least speed [mm/s] at which the resin flows less than one advance while it is lit; 0 for a gel (S22)."""
        if self.viscosity is None:
            return 0.0
        return self.speed * self.viscosity_needed / self.viscosity

    @property
    def broken(self) -> tuple[str, ...]:
        """Limits that the machine exceeds at its speed, with numbers."""
        found = []
        if self.speed > self.limiting.speed:
            found.append(f"{self.speed:.4g} mm/s is above {self.limiting.speed:.4g} mm/s: {self.limiting.reason}")
        if self.speed < self.slowest:
            found.append(f"{self.speed:.4g} mm/s is below {self.slowest:.4g} mm/s: the resin flows off while it is lit")
        if self.defocus > 0.5 * self.depth_of_focus:
            found.append(
                f"{self.lens.bins} depth bins leave {self.defocus:.3g} mm of defocus, more than half the "
                f"depth of focus of {self.depth_of_focus:g} mm; use {self.bins_needed} bins"
            )
        return tuple(found)

    @property
    def lit_time(self) -> float:
        """Time [s] that a piece of the film is in the light, on half a turn and both straight runs."""
        return (pi * self.roller.neutral_radius + 2.0 * self.roller.leg) / self.speed

    @property
    def tolerable_flow(self) -> float:
        """Flow speed [mm/s] at which lit resin moves by the advance of one angle."""
        return self.advance / self.lit_time

    @property
    def viscosity_needed(self) -> float:
        """Viscosity [mJ·s/mm³] above which resin flows slower than this: ρ·g·τ²/(2·u) on a vertical film (S22)."""
        return self.density * GRAVITY * self.roller.film.thickness**2 / (2.0 * self.tolerable_flow)

    @property
    def window(self) -> float:
        """Least length [mm] of a straight run in the window, where light falls to 5 %: −ln(0.05)/α; inf without α."""
        return self.roller.film.penetration

    @property
    def defocus(self) -> float:
        """Largest distance [mm] of a column's film from its focus plane, including the rounding of the lens's power."""
        return float(self.masks.defocus.max()) + self._rounding

    @property
    def bins_needed(self) -> int:
        """Fewest depth bins that keep every column within half the depth of focus."""
        spare = max(0.5 * self.depth_of_focus - self._rounding, self.display.pitch)
        return bins_needed(self.beam, self.roller.radius, self.roller.film.thickness, spare)

    @property
    def _rounding(self) -> float:
        return -0.5 * self.lens.quantum * self.lens.slope

    @property
    def coverage(self) -> float:
        """Range of angles [rad] from which light crosses the film: 2·asin(n_bath / n_resin) (S11)."""
        return self.roller.film.coverage

    @property
    def covered_share(self) -> float:
        """Share of the plane of spatial frequencies, along and into the film, that light reaches."""
        return self.coverage / pi

    def k_space(self, samples: int) -> np.ndarray:
        """Mask (samples, samples) of the frequencies [l, rho] that light reaches; a wedge about rho is missing."""
        k = np.arange(samples) - 0.5 * (samples - 1)
        angle = np.arctan2(np.abs(k)[None, :], np.abs(k)[:, None])
        return (angle <= 0.5 * self.coverage) & (np.hypot(k[:, None], k) <= 0.5 * samples)
