"""The commands ``vam calibrate focus | axis | gray | mtf``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter
from rich.markup import escape

from vamgpu.cli.commands import app
from vamgpu.cli.options import Overwrite, Settings, console

if TYPE_CHECKING:
    from vamgpu.hosts.calibrating.report import Found
    from vamgpu.hosts.calibrating.stand import Stand

group = App(name="calibrate", help="Measure a rig with its camera or photodiode; the rig emulated is a rehearsal.")
app.command(group)
Switch = Annotated[bool, Parameter(negative="")]
Places = Annotated[list[float] | None, Parameter(negative="")]


@group.command
def focus(
    *, rig: str, out: Path = Path("focus"), reach: float = 2.5, step: float = 0.5, low: float = -0.3,
    high: float = 0.3, powers: int = 31, half_period: int = 10, projector: int = 0, settings: Settings = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Find where the lens focuses: a camera steps along the light while the mirrors show a grating.

    Args:
        rig: the TOML file of the rig, or emulated
        out: folder of the result
        reach: of the camera to either side of its stage's middle [mm]
        step: of the camera [mm]
        low: lowest power of the lens [dpt]
        high: highest power of the lens [dpt]
        powers: how many, from low to high
        half_period: of the grating [mirrors]
        projector: which one, from 0
    """
    from vamgpu.hosts.calibrating.focus import TABLES, focus, steps, sweep

    places, stepped = steps(reach, step), sweep(low, high, powers)
    _run(rig, TABLES, out, settings, overwrite, lambda stand, told: focus(
        stand, places, stepped, half_period=half_period, projector=projector, told=told))  # fmt: skip


@group.command
def axis(
    *, rig: str, out: Path = Path("axis"), first: int = 0, stop: int | None = None, every: int = 1, repeats: int = 4,
    radius: float | None = None, flip_r: Switch = False, projector: int = 0, settings: Settings = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Find the roller's axis: one column after another is lit, and a photodiode sees both edges of the shadow.

    Args:
        rig: the TOML file of the rig, or emulated
        out: folder of the result
        first: first column that is lit
        stop: column after the last one
        every: columns from one to the next
        repeats: readings of each
        radius: of the roller [columns], where one edge alone is in reach
        flip_r: jobs are packed with flip_r
        projector: which one, from 0
    """
    from vamgpu.hosts.calibrating.axis import TABLES, axis

    _run(rig, TABLES, out, settings, overwrite, lambda stand, told: axis(
        stand, first=first, stop=stop, every=every, repeats=repeats, radius=radius, flip_r=flip_r,
        projector=projector, told=told))  # fmt: skip


@group.command
def gray(
    *, rig: str, out: Path = Path("gray"), every: int = 1, repeats: int = 4,
    reader: Literal["photodiode", "camera"] = "photodiode", settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Measure what gray levels are worth in light, of each projector.

    Args:
        rig: the TOML file of the rig, or emulated
        out: folder of the result; a job's frames.gray may name its result.toml
        every: levels from one to the next
        repeats: readings of each
        reader: what reads the light
    """
    from vamgpu.hosts.calibrating.gray import gray, levels

    camera, steps = reader == "camera", levels(every)
    _run(rig, (reader,), out, settings, overwrite,
         lambda stand, told: gray(stand, steps, repeats=repeats, camera=camera, told=told))  # fmt: skip


@group.command
def mtf(
    *, rig: str, out: Path = Path("mtf"), at: Places = None, focused: Path | None = None, angle: float = 5.0,
    repeats: int = 4, projector: int = 0, settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Measure how fine the picture is along the light, with a slanted edge.

    Args:
        rig: the TOML file of the rig, or emulated
        out: folder of the result; a job's beam.spread may name it
        at: positions of the camera from its stage's middle [mm]; 0, ±6 and ±15 by default
        focused: result of vam calibrate focus, by which the lens focuses on each position; else it stays as it is
        angle: of the edge against columns [deg]
        repeats: pictures that are averaged
        projector: which one, from 0
    """
    from vamgpu.hosts.calibrating.mtf import POSITIONS, TABLES, mtf
    from vamgpu.hosts.calibrating.report import focused_at

    places = tuple(at) if at else POSITIONS
    powers = None if focused is None else focused_at(focused, places)
    tables = TABLES if powers is None else ("lens", *TABLES)
    _run(rig, tables, out, settings, overwrite, lambda stand, told: mtf(
        stand, places, powers=powers, angle=angle, repeats=repeats, projector=projector, told=told))  # fmt: skip


def _run(
    rig: str, tables: tuple[str, ...], out: Path, settings: list[str] | None, overwrite: bool,
    measure: Callable[[Stand, Callable[[float], None]], Found],
) -> None:  # fmt: skip
    """Open the machines, measure, and write the result."""
    from rich.progress import Progress

    from vamgpu.hosts.calibrating.machines import opened, rehearsal
    from vamgpu.hosts.calibrating.rehearsed import compared
    from vamgpu.hosts.calibrating.report import free, save
    from vamgpu.hosts.rigs.config import read_rig

    screen, config = console(), read_rig(rig, settings or ())
    free(out, overwrite)
    stand, optics = rehearsal(config, tables) if config.wanted.emulated else (opened(config, tables), None)
    try:
        with Progress(console=screen, transient=True, disable=not screen.is_terminal) as bar:
            task = bar.add_task("measuring", total=1.0)
            found = measure(stand, lambda share: bar.update(task, completed=share))
        if optics is not None:
            found = compared(found, optics, stand)
    finally:
        stand.close()
    for name, value in found.lines:
        screen.print(f"  {name:<27} [bold]{escape(value)}[/]")
    screen.print(f"result  [bold]{escape(str(save(found, out, config.text, overwrite=overwrite)))}[/]")
