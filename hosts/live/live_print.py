"""Print a vial that a camera watches: ``vamgpu.live(job, rig)``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.errors import BadInput, JobError
from vamgpu.geometry import positive
from vamgpu.hosts.live.planner import PLACE, light_of
from vamgpu.hosts.process.live_link import LiveOrder
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rig import PrintPlan, carry_out, check, close, opened, plan, read_rig, rehearsal
from vamgpu.hosts.rigs.rehearsal import curing
from vamgpu.hosts.schedules.timing import whole
from vamgpu.jobs.run import prove
from vamgpu.live import CuringResin, LiveRecord, LiveSetup, SensorNoise, Truth, Turbidity, VirtualPrinter
from vamgpu.metrics import score
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial
from vamgpu.printing.frames import Frames
from vamgpu.storage.folder import Folder

FOLLOW = "vamgpu.hosts.live.planner:follow"
WAIT = 60.0  # longest wait of a dry run for its planning process [s]


@dataclass(frozen=True)
class RedCamera:
    """The monitoring camera, whose pixels match those of the beam, and the model of what it sees.

    Args:
        open_field: Gray level through the vial before the print.
        noise: Noise of the camera.
        vial: The vial at the wavelength of the camera's light; None takes the job's, without absorption.
        resin: Assumed kinetics.
        turbidity: Assumed turbidity.
    """

    open_field: float = 800.0
    noise: SensorNoise = field(default_factory=lambda: SensorNoise(read=0.8, gain=0.01, bits=10))
    vial: Vial | None = None
    resin: CuringResin = field(default_factory=CuringResin)
    turbidity: Turbidity = field(default_factory=lambda: Turbidity((0.0, 1.0), (0.0, 0.25)))


@dataclass(frozen=True, eq=False)
class Watched:
    """A monitored print.

    Attributes:
        state: Final state of the print.
        folder: Folder of the run; `vamgpu.live.LiveRecord` reads ``live`` in it.
        decisions: Recorded decision after each turn.
        turns: Number of lit turns.
        iou: Overlap of emulated resin with the part, proved by independent rays; None for real resin.
        conversion: Conversion of emulated resin, [x, y, z]; None for real resin.
    """

    state: PrintState
    folder: Path
    decisions: tuple[dict[str, Any], ...]
    turns: int
    iou: float | None = None
    conversion: np.ndarray | None = None

    def __str__(self) -> str:
        rows = [f"{self.state.value} after {self.turns} turns"]
        for told in self.decisions:
            found = ", ".join(f"{name} {value:.3g} ± {error:.2g}" for name, (value, error) in
                              told["parameters"].items())  # fmt: skip
            begins = "not shown" if told["effective"] is None else f"from turn {told['effective']} on"
            rows.append(
                f"turn {told['turn']:2}  {told['action']:4}  light {told['version']}, {begins}, "
                f"{told['turns']} to go, {told['seconds']:.2f} s  "
                + (f"inhibitor {told['inhibitor']:.2f}, {found}" if found else told["reason"])
            )
        return "\n".join(rows if self.iou is None else [*rows, f"proved overlap {self.iou:.4f}"])


def live(
    job: str | Path, rig: str | Path = "emulated", *, camera: RedCamera | None = None, every: int = 1, turns: int = 16,
    longest: int | None = None, folder: str | Path | None = None, truth: Truth | None = None, seed: int = 0,
    evaluations: float = 8.0, watched: bool = True, board: Board | None = None,
) -> Watched:  # fmt: skip
    """Print a vial while a camera watches it, and replan the remaining patterns after every turn.

    Args:
        job: A folder from `vam solve`: a round vial in even light, at even angles over a full turn.
        rig: The TOML file of the rig, which has a camera, or "emulated".
        camera: The camera and the model of its resin; by default those of the emulated rig.
        every: Number of turns between plans.
        turns: Number of turns in which fresh resin gets the job's dose.
        longest: Greatest number of turns; None for twice ``turns``.
        folder: Folder of the run; it must not exist. None takes the job's name with ``.live``.
        truth: Differences of the emulated print from its plan; None for none.
        seed: Seed of the emulated camera's noise.
        evaluations: Projector evaluations for each plan.
        watched: False prints the job's turns without replanning, for comparison.
        board: Shows the print to an operator; None shows none.

    Returns:
        The print.

    Raises:
        BadInput: The job is not for a vial, `truth` is given for a real rig, or a number is out of range.
        JobError: The rig has no camera.
        StorageError: The job cannot be read, or the run folder exists.
        VamError: The error that ended the print; see `vamgpu.hosts.rig.carry_out`.
    """
    turns, every, seed = whole("turns", turns, 2), whole("every", every), whole("seed", seed, 0)
    evaluations = positive("evaluations", evaluations)
    longest = whole("longest", 2 * turns if longest is None else longest, turns)
    path, camera = Path(job), RedCamera() if camera is None else camera
    planned = plan(path, read_rig(rig), turns=longest, exposure=False)  # the planner decides the dose
    _may_watch(planned, camera, truth)
    frames, A, dose = _even_vial(planned, path, camera.resin.solid)
    light = light_of(frames, turns, dose)
    setup = LiveSetup(
        A.grid.shape, A.grid.pitch, A.beam.pixels, A.beam.pitch, A.motion.angles, A.vessel,
        camera.vial or replace(A.vessel, absorption=0.0), camera.open_field, camera.noise, camera.resin,
        camera.turbidity, max(1.0, frames.scale * dose / turns / float(light.max())), turns, longest,
        evaluations=evaluations, device=open_device().name, ahead=1, every=every, fill=A.beam.fill,
        spread=A.beam.spread, dose=dose, lit_share=A.motion.lit_share,
    )  # fmt: skip
    place = path.with_suffix(".live") if folder is None else Path(folder)
    order = LiveOrder(FOLLOW, settings=asdict(setup), stop=turns, wait=WAIT) if watched else None
    if not planned.rehearsed:
        return _real(planned, place, order, board)
    return _emulated(planned, place, setup, light, order, truth or Truth(), seed, board)


def _may_watch(planned: PrintPlan, camera: RedCamera, truth: Truth | None) -> None:
    """Raise `BadInput` or `JobError` for jobs and rigs that cannot be monitored."""
    for name, value, kind in (("camera", camera, RedCamera), ("truth", truth or Truth(), Truth)):
        if not isinstance(value, kind):
            raise BadInput(f"{name} is {value!r}; expected a {kind.__name__}")
    if planned.kind != "vial":
        raise BadInput(f"{planned.jobs[0].path!r} is for {planned.kind}; expected the job of a vial")
    if truth is not None and not planned.rehearsed:
        raise BadInput("truth is only for emulated resin; leave it out on a real rig")
    if not planned.rehearsed and planned.rig.setup.camera is None:
        raise JobError(f"the rig {planned.rig.setup.rig.name!r} has no camera to watch with; add a [[feedback]] with "
                       'driver = "camera" to its file')  # fmt: skip


def _even_vial(planned: PrintPlan, path: Path, solid: float) -> tuple[Frames, Any, float]:
    """Frames and operator of a round vial with uniform light, and its dose in the method's unit; or `BadInput`."""
    frames, proof = planned.jobs[0].frames, prove(path).proof
    A = proof.operator
    round_vial = isinstance(A, Projection) and isinstance(A.vessel, Vial)
    if frames is None or not round_vial or not A.motion.is_even or A.motion.angles < 2:
        raise BadInput(f"{str(path)!r} is not for a round vial in even light, at two or more even angles over a full "
                       f"turn; expected such a job, got {A!r}")  # fmt: skip
    return frames, A, solid / proof.scores.threshold


def _real(planned: PrintPlan, place: Path, order: LiveOrder | None, board: Board | None) -> Watched:
    machines = opened(planned.rig, True, planned.focus)
    try:
        found = check(planned, machines, live=order is not None)
        state, _ = carry_out(planned, machines, place, board, found, live=order)
    finally:
        close(machines)
    return Watched(state, place, _decisions(place), _turns(place, planned))


def _decisions(place: Path) -> tuple[dict[str, Any], ...]:
    return tuple(LiveRecord(place / PLACE).decisions) if (place / PLACE).is_dir() else ()


def _turns(place: Path, planned: PrintPlan) -> int:
    """Number of lit turns, with a partly lit last one."""
    shown = read_run(place).shown
    lit = shown["slot"][shown["frame"] >= 0]
    return int(lit.max()) // planned.schedule.frames + 1 if lit.size else 0


def _emulated(
    planned: PrintPlan, place: Path, setup: LiveSetup, light: np.ndarray, order: LiveOrder | None, truth: Truth,
    seed: int, board: Board | None,
) -> Watched:  # fmt: skip
    part = np.array(Folder.open(planned.jobs[0].path).array("target"), np.float32)
    printer = VirtualPrinter(setup.projection(setup.vial), setup.camera(), setup.resin, setup.turbidity, truth, seed)
    if order is None:  # without monitoring: only the turns
        dose = printer.dose(light)
        for _ in range(setup.planned):
            printer.turn(dose)
        state, lit = PrintState.COMPLETE, setup.planned
    else:
        stand = rehearsal(planned)
        seen = curing(planned, stand, printer, setup.planned / setup.dose)
        state, _ = carry_out(planned, stand.machines, place, board, live=order)
        seen.cure()
        lit = _turns(place, planned)
    printed, device = printer.printed(), printer.plan.device
    overlap = score(device.upload(printed.astype(np.float32)), device.upload(part), threshold=setup.resin.gel).iou
    return Watched(state, place, _decisions(place), lit, float(overlap), printed)
