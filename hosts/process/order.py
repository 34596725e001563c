"""The order of a print, as plain values for the process that holds the light, and its execution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, Self

from vamgpu.errors import BadInput
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.process.execution import carry_out, check, stopping
from vamgpu.hosts.process.live_link import LiveOrder
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import Board
from vamgpu.hosts.rigs.config import RigConfig, parse_rig
from vamgpu.hosts.rigs.connection import close, opened
from vamgpu.hosts.rigs.planning import PrintPlan, plan
from vamgpu.hosts.rigs.rehearsal import Rehearsal, curing, rehearsal
from vamgpu.printing.given_dose import ProvedDose


@dataclass(frozen=True)
class PrintOrder:
    """Jobs, rig, run folder and options of a print; see `vamgpu.hosts.rig.plan` and `carry_out`."""

    jobs: tuple[str, ...]  # their folders
    rig: str  # text of the rig's file
    source: str  # path of the rig's file
    folder: str  # folder of the run
    settings: tuple[str, ...] = ()
    speed: float | str | None = None
    turns: int | None = None
    exposure: ProvedDose | Literal[False] | None = None  # proved dose of a vial, if known
    stop: float | None = None  # scatter density
    device: str | None = None
    rehearsed: bool = False  # print on emulated machines
    resume: bool = False  # continue the folder's print
    unattended: int = 0
    mend: bool = False  # show frames in doubt again
    page: bool = False  # buttons continue a held print
    asks: bool = False  # whether the client is asked before a held print continues
    live: LiveOrder | None = None  # the planner of coming turns

    @classmethod
    def of(cls, jobs: tuple[Path, ...], rig: RigConfig, folder: Path, **rest: Any) -> Self:
        """An order with absolute paths, for any process."""
        places = tuple(str(job.absolute()) for job in jobs)
        source = rig.source if rig.source == "emulated" else str(Path(rig.source).absolute())
        return cls(places, rig.text, source, str(folder.absolute()), rig.settings, **rest)

    @classmethod
    def parse(cls, told: Any) -> Self:
        """An order from its values by name. Raises `BadInput`."""
        if not isinstance(told, dict) or set(told) != {field.name for field in fields(cls)}:
            raise BadInput(f"an order of a print is {told!r}; expected the values of a PrintOrder by name")
        values: dict[str, Any] = {**told, "jobs": tuple(told["jobs"]), "settings": tuple(told["settings"])}
        if isinstance(values["exposure"], dict):
            values["exposure"] = ProvedDose(**values["exposure"])
        if isinstance(values["live"], dict):
            values["live"] = LiveOrder(**values["live"])
        return cls(**values)

    @property
    def config(self) -> RigConfig:
        """The rig, from the file's text at the time of the order."""
        return parse_rig(self.rig, self.settings, source=self.source)

    @property
    def leased(self) -> bool:
        """Whether a controller gates the light, and switches it off if the process dies."""
        return self.config.setup.light.gate == "controller"

    def planned(self) -> PrintPlan:
        """The plan. Raises as `plan` does."""
        made = plan(
            self.jobs, self.config, speed=self.speed, turns=self.turns, rehearsed=self.rehearsed, device=self.device,
            exposure=self.exposure,
        )  # fmt: skip
        return made if self.stop is None else stopping(made, self.stop)

    def stand(self, planned: PrintPlan, paced: bool = False) -> Rehearsal:
        """Emulated machines of a dry run, with curing resin for a print that is watched."""
        made = rehearsal(planned, paced)
        if self.live is not None and self.live.resin is not None:
            curing(planned, made, self.live.settings, self.live.resin)
        return made


def printed(
    order: PrintOrder, planned: PrintPlan, stand: Rehearsal | None, board: Board, *,
    told: Callable[[str, str], None], go_on: Callable[[Print], bool] | None,
    process: Mapping[str, str] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Print an order's plan; returns how it ended, as a message. told: called with facts. Raises its error."""
    live = order.live
    camera = planned.stop is not None or (live is not None and planned.rig.setup.camera is not None)
    machines = opened(planned.rig, camera, planned.focus) if stand is None else stand.machines
    try:
        found = check(planned, machines, live=live is not None)
        if found is not None:
            told("preflight", str(found))
        state, _ = carry_out(
            planned, machines, order.folder, board, found, order.resume, unattended=order.unattended, go_on=go_on,
            process=process, live=live, mend=order.mend,
        )  # fmt: skip
    finally:
        close(machines)
    if live is not None and live.resin is not None and stand is not None:
        resin: Any = stand.machines.camera
        resin.cure()
        return {"state": state.value, "resin": f"proved overlap {resin.overlap():.4f}"}
    return {"state": state.value} | ({} if stand is None else _seen(planned, stand, order.folder))


def _seen(planned: PrintPlan, stand: Rehearsal, folder: str) -> dict[str, Any]:
    """The verdict of emulated resin, and its levels of a vial's frames."""
    lit = (shown := read_run(folder).shown)[(shown["engine"] == 0) & (shown["dark"] == 0)]
    if not len(shown):
        return {}
    seen = None if planned.stop is None else lit["frame"]
    turns = None if seen is None else -(-len(seen) * planned.schedule.turns // len(planned.schedule))
    engines = range(len(planned.jobs)) if planned.kind == "vial" else ()
    levels = [stand.levels(planned, engine, turns) for engine in engines]
    return {"resin": str(stand.monitor.verdict(seen)), "levels": levels} | ({} if turns is None else {"turns": turns})
