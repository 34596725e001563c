"""Print a vial that a camera watches: ``vamgpu.live(job, rig)``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.hosts.live.cameras import RedCamera, camera_of
from vamgpu.hosts.live.needs import watchable
from vamgpu.hosts.live.planner import PLACE, light_of
from vamgpu.hosts.process.execution import carry_out
from vamgpu.hosts.process.live_link import LiveOrder
from vamgpu.hosts.process.order import PrintOrder
from vamgpu.hosts.process.watch import may_begin, started, watched
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.planning import PrintPlan, plan, speed_of
from vamgpu.hosts.rigs.rehearsal import curing, rehearsal, resin_of
from vamgpu.hosts.schedules.timing import whole
from vamgpu.jobs.run import prove
from vamgpu.live import LiveRecord, LiveSetup, Truth
from vamgpu.optics.vial import Vial
from vamgpu.quantity import counted

FOLLOW = "vamgpu.hosts.live.planner:follow"
WAIT = 60.0  # longest wait of a dry run for its planning process [s]


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
        rows = [f"{self.state.value} after {counted(self.turns, 'turn')}"]
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


@dataclass(frozen=True, eq=False)
class WatchedPlan:
    """A plan, and the order of the process that plans its coming turns."""

    planned: PrintPlan
    order: LiveOrder
    setup: LiveSetup
    light: np.ndarray  # of a turn, [angle, r, z]


def live(
    job: str | Path, rig: str | Path = "emulated", *, camera: RedCamera | None = None, every: int = 1, turns: int = 16,
    longest: int | None = None, folder: str | Path | None = None, truth: Truth | None = None, seed: int = 0,
    evaluations: float = 8.0, watched: bool = True, board: Board | None = None, speed: float | str | None = None,
) -> Watched:  # fmt: skip
    """Print a vial while a camera watches it, and replan the remaining patterns after every turn.

    A separate process holds the light of real machines, and continues printing if this one ends.

    Args:
        job: A folder from `vam solve`: a round vial in uniform light, at even angles over a full turn.
        rig: The TOML file of the rig, which has a camera, or "emulated".
        camera: The camera and the model of its resin; by default as `vam calibrate live` measured it, or those of the
            emulated rig.
        every: Number of turns between plans.
        turns: Number of turns in which fresh resin gets the job's dose.
        longest: Greatest number of turns; None for twice ``turns``.
        folder: Folder of the run; it must not exist. None takes the job's name with ``.live``.
        truth: Differences of the emulated print from its plan; None for none.
        seed: Seed of the emulated camera's noise.
        evaluations: Projector evaluations for each plan.
        watched: False prints the job's turns without replanning, for comparison on emulated machines.
        board: Shows the print to an operator; None shows none.
        speed: Speed of the vial [deg/s], or with its unit; None takes the usual one.

    Returns:
        The print.

    Raises:
        BadInput: `truth` is given for a real rig, or a number is out of range.
        JobError: A need of a watched print does not hold; the message lists all of them.
        StorageError: The job cannot be read, or the run folder exists.
        VamError: The error that ended the print; see `vamgpu.hosts.rig.carry_out`.
    """
    config = read_rig(rig)
    made = watched_plan(
        job, config, camera=camera, every=every, turns=turns, longest=longest, truth=truth, seed=seed,
        evaluations=evaluations, speed=speed,
    )  # fmt: skip
    path, place = Path(job), Path(job).with_suffix(".live") if folder is None else Path(folder)
    if made.planned.rehearsed:
        return _emulated(made, place, board, watched)
    if not watched:
        raise BadInput("watched=False is for emulated machines; leave it out, or use vam print")
    return _real(made, path, place, board)


def watched_plan(
    job: str | Path, rig: Any, *, camera: RedCamera | None = None, every: int = 1, turns: int = 16,
    longest: int | None = None, truth: Truth | None = None, seed: int = 0, evaluations: float = 8.0,
    speed: float | str | None = None, rehearsed: bool = False, device: str | None = None,
) -> WatchedPlan:  # fmt: skip
    """The plan of a watched print on a `RigConfig`; see `live`. rehearsed: on emulated machines, on any rig."""
    turns, every, seed = whole("turns", turns, 2), whole("every", every), whole("seed", seed, 0)
    evaluations = positive("evaluations", evaluations)
    longest = whole("longest", 2 * turns if longest is None else longest, turns)
    real = not (rehearsed or rig.setup.emulated)
    watchable(Path(job), rig, speed_of(speed, "vial"), real=real, measured=real and camera is None)
    planned = plan(job, rig, speed=speed, turns=longest, exposure=False, rehearsed=rehearsed, device=device)
    if truth is not None and not (isinstance(truth, Truth) and planned.rehearsed):
        raise BadInput(f"truth is {truth!r}; expected a Truth, and only for emulated resin")
    frames, proof = planned.jobs[0].frames, prove(job).proof
    A: Any = proof.operator
    assert frames is not None and isinstance(A.vessel, Vial)
    camera = camera_of(planned, camera, A.beam.pitch)
    dose = camera.resin.solid / proof.scores.threshold
    light = light_of(frames, turns, dose)
    open_field, noise, view = camera.on_beam(planned, A.beam.pixels)
    setup = LiveSetup(
        A.grid.shape, A.grid.pitch, A.beam.pixels, A.beam.pitch, A.motion.angles, A.vessel,
        camera.vial or replace(A.vessel, absorption=0.0), open_field, noise, camera.resin,
        camera.turbidity, max(1.0, frames.scale * dose / turns / float(light.max())), turns, longest,
        evaluations=evaluations, device=open_device(device).name, ahead=1, every=every, fill=A.beam.fill,
        spread=A.beam.spread, dose=dose, lit_share=A.motion.lit_share,
    )  # fmt: skip
    setup.camera()  # so that a wrong description ends here, not in the print
    settings = {"setup": asdict(setup), "view": None if view is None else asdict(view), "noise": asdict(camera.noise)}
    resin = {"truth": asdict(truth or Truth()), "seed": seed} if planned.rehearsed else None
    return WatchedPlan(planned, LiveOrder(FOLLOW, settings=settings, stop=turns, wait=WAIT, resin=resin), setup, light)


def _real(made: WatchedPlan, job: Path, place: Path, board: Board | None) -> Watched:
    """Print in the process that holds the light."""
    planned = made.planned
    speed = float(planned.schedule.speed)
    order = PrintOrder.of((job,), planned.rig, place, speed=speed, turns=made.setup.longest, exposure=False,
                          live=made.order)  # fmt: skip
    may_begin(place)
    with started(order, board or Board()) as watch:
        ended = watched(watch, lambda name, text: None, None)
    return Watched(PrintState(ended["state"]), place, decisions_in(place), _turns(place, planned))


def decisions_in(place: Path) -> tuple[dict[str, Any], ...]:
    """Recorded decisions of a run; none if nothing was watched."""
    return tuple(LiveRecord(place / PLACE).decisions) if (place / PLACE).is_dir() else ()


def _turns(place: Path, planned: PrintPlan) -> int:
    """Number of lit turns, with a partly lit last one."""
    shown = read_run(place).shown
    lit = shown["slot"][shown["frame"] >= 0]
    return int(lit.max()) // planned.schedule.frames + 1 if lit.size else 0


def _emulated(made: WatchedPlan, place: Path, board: Board | None, watched: bool) -> Watched:
    planned, order, setup = made.planned, made.order, made.setup
    assert order.resin is not None
    if watched:
        stand = rehearsal(planned)
        resin = curing(planned, stand, order.settings, order.resin)
        state, _ = carry_out(planned, stand.machines, place, board, live=order)
        resin.cure()
        lit = _turns(place, planned)
    else:  # only the turns
        resin = resin_of(planned, order.settings, order.resin)
        dose = resin.printer.dose(made.light)
        for _ in range(setup.planned):
            resin.printer.turn(dose)
        state, lit = PrintState.COMPLETE, setup.planned
    return Watched(state, place, decisions_in(place), lit, resin.overlap(), resin.printer.printed())
