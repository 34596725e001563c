"""A print in two colors, simulated frame by frame, that can be interrupted and resumed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vamgpu.chemistry.concentrations import Concentrations
from vamgpu.chemistry.exposure import ColorExposure
from vamgpu.chemistry.transport import Transport
from vamgpu.errors import BadInput, UnstableStep
from vamgpu.geometry import counts, positive

Progress = Callable[[int, Concentrations], None]


@dataclass(frozen=True, eq=False)
class PrintRun:
    """Turns of a dual-color print: light of each angle for the time of a frame, absorbed by the remaining C.
    Source: paper, "Reactive Transport Simulation".

    Args:
        transport: Diffusion and reaction of the species.
        exposure: The light of a turn.
        turn: Time of a turn [s].
        turns: Number of turns.
        steps: Steps of transport per frame; by default the fewest that are stable (see `Transport.advance`).

    Raises:
        BadInput: A value is out of its range.
        UnstableStep: The steps are too long to be stable.
    """

    transport: Transport
    exposure: ColorExposure
    turn: float
    turns: int
    steps: int | None = None

    def __post_init__(self) -> None:
        positive("turn [s]", self.turn)
        counts("turns", (self.turns,), 1)
        if self.exposure.box != self.transport.box or self.exposure.device is not self.transport.device:
            raise BadInput("exposure and transport have different boxes or devices; expected the same")
        if self.transport.reaction is None:
            raise BadInput("the transport has only diffusion; expected one with a reaction")
        if self.steps is not None and self.frame_time / self.steps > self.transport.limit:
            raise UnstableStep(
                f"{self.steps} steps per frame of {self.frame_time:g} s are not stable; expected steps of at most "
                f"{self.transport.limit:g} s: {self.transport.steps(self.frame_time)} or more",
                self.transport.limit,
            )

    @property
    def frame_time(self) -> float:
        """Time for which a frame is shown [s]."""
        return self.turn / self.exposure.angles

    @property
    def frames(self) -> int:
        """Number of frames of the whole print."""
        return self.turns * self.exposure.angles

    def run(
        self,
        state: Concentrations,
        frame: int = 0,
        until: int | None = None,
        progress: Progress | None = None,
    ) -> int:
        """Show frames ``frame`` … ``until`` − 1, which changes the state.

        Args:
            state: Concentrations, changed in place.
            frame: The first frame.
            until: The frame to stop before; the end by default.
            progress: Called with the next frame and the state after each frame.

        Returns:
            The next frame.
        """
        last = min(self.frames, until if until is not None else self.frames)
        while frame < last:
            visible, ultraviolet = self.exposure.irradiance(state.c, frame)
            self.transport.advance(state, self.frame_time, self.steps, visible, ultraviolet)
            state.time = self.frame_time * (frame + 1)  # not a running sum; a resumed print then ends the same
            frame += 1
            if progress:
                progress(frame, state)
        return frame
