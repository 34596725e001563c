"""An order on its machines: checked, carried out, closed, and what emulated resin saw of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from vamgpu.hosts.live.link import LiveOrder
from vamgpu.hosts.realtime.order import PrintOrder
from vamgpu.hosts.record import read_run
from vamgpu.hosts.rig import carry_out, check, close, opened
from vamgpu.hosts.rigs.planning import PrintPlan
from vamgpu.hosts.rigs.rehearsing import Rehearsal
from vamgpu.hosts.run import Print
from vamgpu.hosts.state import Board


def printed(
    order: PrintOrder, planned: PrintPlan, stand: Rehearsal | None, board: Board, *,
    told: Callable[[str, str], None], go_on: Callable[[Print], bool] | None,
    process: Mapping[str, str] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Print an order's plan; how it ended, as messages tell it. told: hears facts by name. Raises what ended it."""
    live = None if order.live is None else LiveOrder(order.live, order.allowance)
    camera = planned.stop is not None or (live is not None and planned.rig.setup.camera is not None)
    machines = opened(planned.rig, camera, planned.focus) if stand is None else stand.machines
    try:
        found = check(planned, machines, live=live is not None)
        if found is not None:
            told("preflight", str(found))
        state, _ = carry_out(
            planned, machines, order.folder, board, found, order.resume, unattended=order.unattended, go_on=go_on,
            process=process, live=live,
        )  # fmt: skip
    finally:
        close(machines)
    return {"state": state.value} | ({} if stand is None else _seen(planned, stand, order.folder))


def _seen(planned: PrintPlan, stand: Rehearsal, folder: str) -> dict[str, Any]:
    """The verdict of emulated resin, and the levels that it saw of a vial's frames."""
    lit = (shown := read_run(folder).shown)[(shown["engine"] == 0) & (shown["dark"] == 0)]
    if not len(shown):
        return {}
    seen = None if planned.stop is None else lit["frame"]
    turns = None if seen is None else -(-len(seen) // planned.schedule.frames)
    engines = range(len(planned.jobs)) if planned.kind == "vial" else ()
    levels = [stand.levels(planned, engine, turns) for engine in engines]
    return {"resin": str(stand.monitor.verdict(seen)), "levels": levels} | ({} if turns is None else {"turns": turns})
