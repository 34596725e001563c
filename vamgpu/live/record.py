"""The record of a live print: the plan, the images of each turn, and every decision."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.live.camera import MonitoringCamera, SensorNoise
from vamgpu.live.estimate import Estimator
from vamgpu.live.loop import Decision, LiveLoop, LiveState
from vamgpu.live.printer import CuringResin
from vamgpu.live.replan import Replanner
from vamgpu.live.tomography import Tomograph
from vamgpu.live.turbidity import Turbidity
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial
from vamgpu.storage.atomic import explained, explaining
from vamgpu.storage.numpy_files import map_npy
from vamgpu.storage.reading import parse_json, read_text

SETUP, DECISIONS = "live.json", "live.jsonl"
STAGES = ("sense", "see", "estimate", "replan", "pack", "upload")
"""Stages of a decision: images become a field, then parameters, light and frames, which are checked and saved."""
ENTRY = "turn", "action", "version", "turns", "inhibitor", "parameters", "iou", "reason", "light"
"""Keys of every decision in a record."""


@dataclass(frozen=True)
class LiveSetup:
    """Everything that a `LiveLoop` consists of, except part and light, as plain values.

    Args:
        shape: Voxels of the grid.
        pitch: Pitch of the voxels [mm].
        pixels: Columns and rows of both beam and camera.
        pixel: Their pitch [mm].
        angles: Images of a turn.
        vial: The vial for the printing light.
        red: The vial for the camera's light; absorbs nothing.
        open_field: Gray level through the vial before the print, or levels [row][column].
        noise: Noise of the camera.
        resin: Assumed kinetics.
        turbidity: Assumed turbidity.
        most: Greatest light of a pixel, relative to the brightest of the plan.
        planned: Turns of the plan.
        longest: Greatest number of turns that the user allows.
        iterations: Projector evaluations of the tomograph per decision.
        evaluations: Projector evaluations of the replanner per decision.
        device: Device of the decisions; other devices round differently.
        ahead: Number of turns that begin before a decision can reach the projector.
        every: Number of turns from one decision to the next.
        fill: Share of a pixel of the beam that is lit.
        spread: Standard deviation of the beam's point spread [mm]; None for half a pixel.
        dose: Dose of one unit of planned light, in units of the resin's dose.
        lit_share: Share of each step during which its image is lit while the vial turns; camera images are taken at its
            angle.
        rings: Whether to reconstruct and plan on rings, see `vamgpu.RingProjection`; None if they are faster.
    """

    shape: tuple[int, int, int]
    pitch: float
    pixels: tuple[int, int]
    pixel: float
    angles: int
    vial: Vial
    red: Vial
    open_field: Any
    noise: SensorNoise
    resin: CuringResin
    turbidity: Turbidity
    most: float
    planned: int
    longest: int
    iterations: int = 8
    evaluations: float = 8.0
    device: str = ""
    ahead: int = 0
    every: int = 1
    fill: float = 1.0
    spread: float | None = None
    dose: float = 1.0
    rings: bool | None = None
    lit_share: float = 1.0

    def projection(self, vial: Vial, beam: Beam | None = None) -> Projection:
        """Rays through a vial, on the device of this setup.

        Args:
            vial: The vial for one of the two lights.
            beam: The beam; None for that of the printing light.

        Returns:
            The operator.
        """
        device = open_device(self.device or None)
        return Projection(
            Grid(self.shape, self.pitch), beam or Beam(self.pixels, self.pixel, self.fill, self.spread),
            Turntable(self.angles, lit_share=self.lit_share), vial, device=device,
        )  # fmt: skip

    def camera(self) -> MonitoringCamera:
        """The camera on the plan's grid."""
        rays = replace(self, lit_share=0.0).projection(self.red, Beam(self.pixels, self.pixel))
        return MonitoringCamera(rays, self.open_field, self.noise)

    def loop(self, part: np.ndarray, light: np.ndarray) -> LiveLoop:
        """The loop of a print.

        Args:
            part: Fractions, [x, y, z].
            light: Light of each turn of the plan, [angle, r, z].

        Returns:
            The loop, before its first turn.
        """
        replanner = Replanner(part, most=self.most * float(light.max()), threshold=self.resin.solid)
        estimator = Estimator(self.projection(self.vial), self.resin.response, rings=self.rings)
        return LiveLoop(
            Tomograph(self.camera(), self.turbidity, rings=self.rings), estimator, replanner, self.resin, light,
            self.planned, self.longest, self.iterations, self.evaluations, ahead=self.ahead, every=self.every,
        )  # fmt: skip

    @classmethod
    def of(cls, entries: dict[str, Any]) -> LiveSetup:
        """Read the values that `dataclasses.asdict` made of a setup.

        Args:
            entries: The values by name.

        Returns:
            The setup.

        Raises:
            BadInput: Names are missing or unknown, or values out of range.
        """
        kinds = {"vial": Vial, "red": Vial, "noise": SensorNoise, "resin": CuringResin, "turbidity": Turbidity}
        try:
            plain: dict[str, Any] = {
                name: kinds[name](**value) if name in kinds else value for name, value in entries.items()
            }
            plain |= {name: tuple(plain[name]) for name in ("shape", "pixels")}
            plain.setdefault("lit_share", 0.0)  # a setup without this key is from a vial at rest
            return cls(**plain)
        except (TypeError, KeyError) as error:
            raise BadInput(f"the setup of a live print cannot be read ({error}); expected the names of LiveSetup: "
                           f"restore {SETUP}") from error  # fmt: skip


class LiveRecord:
    """A folder with `live.json`, `live.jsonl`, and arrays: part, light of the plan, frames of every turn.

    Args:
        folder: Folder of the run.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder: Path = Path(folder)

    @property
    def begun(self) -> bool:
        """Whether the folder holds a live print."""
        return (self.folder / DECISIONS).exists()

    def begin(self, setup: LiveSetup, part: np.ndarray, light: np.ndarray) -> LiveLoop:
        """Start a record.

        Args:
            setup: Setup of the loop.
            part: Fractions, [x, y, z].
            light: Light of each turn of the plan, [angle, r, z].

        Returns:
            The loop that was recorded.

        Raises:
            StorageError: The folder already holds a live print, or cannot be written.
        """
        if self.begun:
            raise StorageError(f"{str(self.folder)!r} already holds a live print; use another folder")
        with explaining("write", self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / SETUP).write_text(json.dumps(asdict(setup), indent=1))
            np.save(self.folder / "live-part.npy", part)
            np.save(self.folder / "live-light.npy", light)
            (self.folder / DECISIONS).write_text("")
        return setup.loop(part, light)

    def add(self, frames: np.ndarray, decision: Decision, **facts: Any) -> None:
        """Add a turn; its frames are written first, so that every decision has its frames.

        Args:
            frames: Gray levels, [angle, row, column].
            decision: The decision from them.
            facts: Further facts to store: ``showed``, see `LiveLoop.corrected`, and the time of the decision [s].

        Raises:
            StorageError: The folder cannot be written.
        """
        with explaining("write", self.folder):
            np.save(self._frames(decision.turn), frames)
            with (self.folder / DECISIONS).open("a") as file:
                file.write(json.dumps(decision.entry | {"stages": _rounded(decision.stages)} | facts) + "\n")

    def note(self, turn: int, stages: Mapping[str, float] | None = None, **facts: Any) -> None:
        """Add facts about a decision that are known later, such as the time of its upload.

        Args:
            turn: Turn of the decision.
            stages: Further wall times [s] by name.
            facts: Facts that replace those of `add`.

        Raises:
            StorageError: The folder cannot be written.
        """
        with explaining("write", self.folder), (self.folder / DECISIONS).open("a") as file:
            file.write(json.dumps({"of": turn, "stages": _rounded(stages or {})} | facts) + "\n")

    @property
    def decisions(self) -> list[dict[str, Any]]:
        """Recorded decisions in order, each with facts added later."""
        lines, entries = self._text(DECISIONS).splitlines(), dict[int, dict[str, Any]]()
        try:
            for each in map(parse_json, lines):
                if "of" in each:
                    was = entries[each.pop("of")]
                    was |= each | {"stages": was.get("stages", {}) | each["stages"]}
                else:
                    entries[each["turn"]] = {name: each[name] for name in ENTRY} | each
        except (ValueError, KeyError, TypeError) as error:
            raise StorageError(f"{DECISIONS} in {str(self.folder)!r} is damaged: {error!r}") from error
        return list(entries.values())

    def decided(self) -> list[dict[str, Any]]:
        """The decisions; there is at least one.

        Returns:
            As `decisions`.

        Raises:
            StorageError: There is no decision, or the file is missing or damaged.
        """
        entries = self.decisions
        if not entries:
            raise StorageError(f"{str(self.folder)!r} holds no decision; use the record of a print that was watched")
        return entries

    def setup(self) -> LiveSetup:
        """The setup of the loop.

        Raises:
            BadInput: It cannot be read.
            StorageError: The file is missing or damaged.
        """
        try:
            return LiveSetup.of(parse_json(self._text(SETUP)))
        except ValueError as error:
            raise StorageError(f"{SETUP} in {str(self.folder)!r} is damaged: {error}") from error

    def part(self) -> np.ndarray:
        """Fractions of the part, [x, y, z].

        Raises:
            StorageError: The file is missing or damaged.
        """
        return np.array(map_npy(self.folder / "live-part.npy"))

    def replay(self) -> Iterator[tuple[dict[str, Any], list[str]]]:
        """Repeat the decision of every turn from the recorded images.

        Yields:
            The recorded decision, and the names of values that now differ; none if it is the same bit for bit.

        Raises:
            BadInput: The setup cannot be read.
            StorageError: A file is missing or damaged.
        """
        for was, _, now in self.again():
            entries = parse_json(json.dumps(now.entry))
            yield was, [name for name in entries if entries[name] != was.get(name)]

    def again(self) -> Iterator[tuple[dict[str, Any], np.ndarray, Decision]]:
        """Repeat the print, turn by turn.

        Yields:
            The recorded decision of each turn, its frames, [angle, row, column], and the repeated decision.

        Raises:
            BadInput: The setup cannot be read.
            StorageError: A file is missing or damaged.
        """
        told = self.decisions
        for was, frames, (_, decision) in zip(told, self._turns(told), self.states(self.loop()), strict=True):
            yield was, frames, decision

    def loop(self) -> LiveLoop:
        """The loop of the recorded print, before its first turn.

        Raises:
            BadInput: The setup cannot be read.
            StorageError: A file is missing or damaged.
        """
        return self.setup().loop(self.part(), np.array(map_npy(self.folder / "live-light.npy")))

    def states(self, loop: LiveLoop) -> Iterator[tuple[LiveState, Decision]]:
        """Repeat the print with a loop.

        Args:
            loop: A loop made by `loop`, before its first turn.

        Yields:
            The state and the repeated decision after each turn.

        Raises:
            StorageError: A file is missing or damaged.
        """
        told = self.decisions
        yield from loop.states(self._turns(told), [was.get("showed", ()) for was in told])

    def _turns(self, told: Sequence[Mapping[str, Any]]) -> Iterator[np.ndarray]:
        return (self.frames(each["turn"]) for each in told)

    def frames(self, turn: int) -> np.ndarray:
        """Frames of a turn.

        Args:
            turn: Number of the turn, from 1.

        Returns:
            Gray levels, [angle, row, column].

        Raises:
            StorageError: The file is missing or damaged.
        """
        return np.array(map_npy(self._frames(turn)))

    def _frames(self, turn: int) -> Path:
        return self.folder / f"live-frames-{turn:04}.npy"

    def _text(self, name: str) -> str:
        try:
            return read_text(self.folder / name)
        except FileNotFoundError as error:
            raise StorageError(f"{str(self.folder)!r} has no {name}; expected the folder of a run that was watched, "
                               "as `vam print --live` makes one") from error  # fmt: skip
        except OSError as error:
            raise explained("read", self.folder / name, error) from error


def _rounded(stages: Mapping[str, float]) -> dict[str, float]:
    return {name: round(seconds, 4) for name, seconds in stages.items()}


def budget(decisions: Sequence[Mapping[str, Any]]) -> list[tuple[str, float, float, int]]:
    """Name, median and greatest wall time [s], and number of decisions of each stage."""
    entries = [each.get("stages", {}) for each in decisions]
    names = [name for name in STAGES if any(name in each for each in entries)]
    times = {name: [each[name] for each in entries if name in each] for name in names}
    return [(name, float(np.median(each)), max(each), len(each)) for name, each in times.items()]
