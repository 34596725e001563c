"""A print in two colors, simulated frame by frame, that can be interrupted and resumed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from vamgpu.chemistry.concentrations import Concentrations
from vamgpu.chemistry.exposure import ColorExposure
from vamgpu.chemistry.transport import Transport
from vamgpu.errors import BadInput, StorageError, UnstableStep
from vamgpu.geometry import counts, positive
from vamgpu.storage.atomic import replacing
from vamgpu.storage.numpy_files import read_npz

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
        save: str | Path | None = None,
        every: int | None = None,
        progress: Progress | None = None,
    ) -> int:
        """Show frames ``frame`` … ``until`` − 1, which changes the state.

        Args:
            state: Concentrations, changed in place.
            frame: The first frame.
            until: The frame to stop before; the end by default.
            save: A file that is replaced after every ``every`` frames and at the end; see `load`.
            every: Frames between two saves; a turn by default.
            progress: Called with the next frame and the state after each frame.

        Returns:
            The next frame.
        """
        last = min(self.frames, until if until is not None else self.frames)
        pace = every or self.exposure.angles
        while frame < last:
            visible, ultraviolet = self.exposure.irradiance(state.c, frame)
            self.transport.advance(state, self.frame_time, self.steps, visible, ultraviolet)
            state.time = self.frame_time * (frame + 1)  # not a running sum; a resumed print then ends the same
            frame += 1
            if progress:
                progress(frame, state)
            if save is not None and (frame % pace == 0 or frame == last):
                self.save(save, state, frame)
        return frame

    def save(self, path: str | Path, state: Concentrations, frame: int) -> None:
        """Write the state before ``frame`` atomically to an .npz file.

        Args:
            path: The .npz file.
            state: Concentrations.
            frame: The frame that comes next.

        Raises:
            StorageError: The file cannot be written.
        """
        with replacing(path, overwrite=True) as draft, draft.open("wb") as file:
            about = {"frame": np.array(frame), "time": np.array(state.time), "print": np.array(self.fingerprint)}
            np.savez(file, **about, **state.numpy())  # pyright: ignore[reportArgumentType] - names of arrays, not options

    def load(self, path: str | Path) -> tuple[Concentrations, int]:
        """Read the file that `run` saved.

        Args:
            path: The file.

        Returns:
            The state and the next frame.

        Raises:
            StorageError: The file cannot be read, or belongs to another print.
        """
        try:
            found = read_npz(path)
            fields = [self.transport.device.upload(found[name]) for name in Concentrations.FIELDS]
            frame, time, owner = int(found["frame"]), float(found["time"]), str(found["print"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise StorageError(f"cannot read the print in {str(path)!r}: {error}; start it again") from error
        if owner != self.fingerprint:
            raise StorageError(f"{str(path)!r} is of another print: its resin, light or times differ; start it again")
        return Concentrations(*fields, time), frame  # pyright: ignore[reportCallIssue] - as many as FIELDS

    @cached_property
    def fingerprint(self) -> str:
        """Digest of everything that determines the rest of the print."""
        t, e = self.transport, self.exposure
        settings = (t.box, t.diffusivities, t.reaction, t.boundaries, e.extinction, e.pitch, self.turn, self.steps)
        digest = hashlib.sha256(repr(settings).encode())
        if e.motion is not None and not e.motion.is_even:
            digest.update(e.motion.poses.tobytes())
        for light in (e.visible, e.ultraviolet):
            digest.update(b"-" if light is None else np.ascontiguousarray(light, np.float32).tobytes())
        return digest.hexdigest()
