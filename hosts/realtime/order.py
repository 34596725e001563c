"""The order of a print, in values that cross a pipe to the process that holds the light."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal, Self

from vamgpu.errors import BadInput
from vamgpu.hosts.rig import stopping
from vamgpu.hosts.rigs.config import RigConfig, parse_rig
from vamgpu.hosts.rigs.planning import PrintPlan, plan
from vamgpu.printing.given_dose import ProvedDose


@dataclass(frozen=True)
class PrintOrder:
    """Jobs, rig, run folder and options of a print; see `vamgpu.hosts.rig.plan` and `carry_out`.

    jobs: their folders.  rig, settings, source: of its file.  folder: of the run.  rehearsed: on emulated machines.
    exposure: what is known of the proof of a vial.  stop: density of scatter.  resume: go on with the folder's print.
    page: buttons let a print that is held go on.  asks: who watches is asked whether it goes on.  live: function that
    plans turns to come, ``module:function``.  allowance: light that it may add over the job's.
    """

    jobs: tuple[str, ...]
    rig: str
    source: str
    folder: str
    settings: tuple[str, ...] = ()
    speed: float | str | None = None
    turns: int | None = None
    exposure: ProvedDose | Literal[False] | None = None
    stop: float | None = None
    device: str | None = None
    rehearsed: bool = False
    resume: bool = False
    unattended: int = 0
    page: bool = False
    asks: bool = False
    live: str | None = None
    allowance: float = 0.0

    @classmethod
    def of(cls, jobs: tuple[Path, ...], rig: RigConfig, folder: Path, **rest: Any) -> Self:
        """An order that any process understands, wherever it runs."""
        places = tuple(str(job.absolute()) for job in jobs)
        source = rig.source if rig.source == "emulated" else str(Path(rig.source).absolute())
        return cls(places, rig.text, source, str(folder.absolute()), rig.settings, **rest)

    @classmethod
    def parse(cls, told: Any) -> Self:
        """An order as `plain` wrote it. Raises `BadInput`."""
        if not isinstance(told, dict) or set(told) != {field.name for field in fields(cls)}:
            raise BadInput(f"an order of a print is {told!r}; expected the values of a PrintOrder by name")
        values: dict[str, Any] = {**told, "jobs": tuple(told["jobs"]), "settings": tuple(told["settings"])}
        if isinstance(values["exposure"], dict):
            values["exposure"] = ProvedDose(**values["exposure"])
        return cls(**values)

    def plain(self) -> dict[str, Any]:
        """The values by name, as JSON takes them."""
        return asdict(self)

    @property
    def config(self) -> RigConfig:
        """The rig, as its file was when the order was given."""
        return parse_rig(self.rig, self.settings, source=self.source)

    @property
    def leased(self) -> bool:
        """Whether a controller gates the light, and closes it for a process that is gone."""
        return self.config.setup.light.gate == "controller"

    def planned(self) -> PrintPlan:
        """The plan. Raises what `plan` raises."""
        made = plan(
            self.jobs, self.config, speed=self.speed, turns=self.turns, rehearsed=self.rehearsed, device=self.device,
            exposure=self.exposure,
        )  # fmt: skip
        return made if self.stop is None else stopping(made, self.stop)
