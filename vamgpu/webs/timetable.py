"""Times at which a web machine commands its lens, triggers its mirrors, and lights them.

Source: J. Toombs et al., "Roll-to-roll tomographic volumetric additive manufacturing", section S14: the command for the
lens goes out, right after it the trigger, and the mirrors wait for the lens to settle before they show their frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import counts, positive
from vamgpu.printing.focus import slots
from vamgpu.webs.limits import WebLimits

TICK = 1e-6
"""Default time step [s] of the clock that sends commands and triggers."""


@dataclass(frozen=True, eq=False)
class Timetable:
    """Times [s] of every frame of some angles, (poses, bins), from the start of the web's first angle."""

    plane: np.ndarray  # which focus plane is shown
    power: np.ndarray  # of the lens [dpt]
    command: np.ndarray  # when the command for the lens is sent; NaN if the lens keeps its power
    trigger: np.ndarray  # of the mirrors
    start: np.ndarray  # when light goes on
    stop: np.ndarray  # when light goes off; equally long for all frames
    delay: float  # from trigger to light [s], set once in the mirrors


def timetable(limits: WebLimits, poses: int, first: int = 0, tick: float = TICK) -> Timetable:
    """Times of some angles, each rounded to the clock from the start of the web; errors then do not add up.

    Args:
        limits: The machine and its speed.
        poses: Number of angles.
        first: Number of the first angle.
        tick: Period of the clock [s].

    Returns:
        The times.

    Raises:
        BadInput: The speed leaves frames less time than the mirrors need.
    """
    count, tick = counts("poses", (poses,), 1)[0], positive("tick [s]", tick)
    if isinstance(first, bool) or not isinstance(first, int) or first < 0:
        raise BadInput(f"first is {first!r}; expected the number of an angle, 0 or more")
    shown, bins = limits.display, limits.lens.bins
    period, busy = 1.0 / limits.pose_rate, shown.wire + limits.lens.settle
    lit = (period - limits.moves * busy) / bins
    if lit < (1.0 - 1e-9) / shown.rate + 2.0 * tick * (limits.moves > 0):
        raise BadInput(
            f"at {limits.speed:.4g} mm/s a frame is lit for {1e3 * lit:.4g} ms, and the mirrors need "
            f"{1e3 / shown.rate:.4g} ms and two ticks; expected less than {limits.limiting.speed:.4g} mm/s"
        )
    plane = slots(first + count, bins, turning=shown.turning)[first:]
    moves = np.ones((count, bins), bool)
    if limits.moves < bins:  # what was shown last is shown first
        moves[:, 0] = False
    wait = np.where(moves, busy, 0.0)
    begin = (first + np.arange(count))[:, None] * period + np.cumsum(wait + lit, axis=1) - wait - lit
    command = _on_clock(np.where(moves, begin, np.nan), tick)
    trigger = _on_clock(begin + np.where(moves, shown.wire, -limits.lens.settle), tick)
    start = trigger + limits.lens.settle
    return Timetable(plane, limits.lens.power(np.array(limits.masks.planes))[plane], command, trigger, start,
                     start + lit - 2.0 * tick * (limits.moves > 0), limits.lens.settle)  # fmt: skip


def _on_clock(time: np.ndarray, tick: float) -> np.ndarray:
    return np.round(time / tick) * tick
