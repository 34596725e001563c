"""Jobs on rigs, for programs: read a rig, plan, open or emulate the machines, check them, and print."""

from __future__ import annotations

from vamgpu.hosts.process.execution import carry_out, check, player, stopping
from vamgpu.hosts.process.resume import limits, may_go_on
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.connection import close, opened
from vamgpu.hosts.rigs.planning import PrintPlan, plan
from vamgpu.hosts.rigs.rehearsal import Rehearsal, rehearsal

__all__ = [
    "PrintPlan", "Rehearsal", "carry_out", "check", "close", "limits", "may_go_on", "opened", "plan", "player",
    "read_rig", "rehearsal", "stopping",
]  # fmt: skip
