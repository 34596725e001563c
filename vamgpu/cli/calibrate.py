"""The commands ``vam calibrate focus | axis | gray | flat | mtf | runout | turn | live | scatter | list``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter
from rich.markup import escape

from vamgpu.cli.commands import app
from vamgpu.cli.options import Overwrite, Settings, Switch, Whole, console

if TYPE_CHECKING:
    from vamgpu.hosts.calibrate.report import CalibrationResult
    from vamgpu.hosts.rigs.config import RigConfig
    from vamgpu.live.turbidity import MeasuredTurbidity

group: App = App(
    name="calibrate", help="Measure a rig with its camera or photodiode, or a resin; --rig emulated is a dry run."
)
app.command(group)
Places = Annotated[list[float] | None, Parameter(negative="")]
Rig = Annotated[str, Parameter(help="the TOML file of the rig, or emulated")]
Out = Annotated[
    Path | None, Parameter(help="folder of the result; beside the rig's file by default, where prints find it")
]
Projector = Annotated[int, Parameter(help="number of the projector, from 0")]


@group.command
def focus(
    *, rig: Rig, out: Out = None, reach: float = 2.5, step: float = 0.5, low: float = -0.3,
    high: float = 0.3, powers: int = 31, half_period: int = 10, projector: Projector = 0, settings: Settings = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Find where the lens focuses: a camera steps along the light while the mirrors show a grating.

    Args:
        reach: travel of the camera to either side of its stage's center [mm]
        step: step of the camera [mm]
        low: lowest power of the lens [dpt]
        high: highest power of the lens [dpt]
        powers: number of powers, from low to high
        half_period: half period of the grating [mirrors]
    """
    from vamgpu.hosts.calibrate.focus import TABLES, focus, steps, sweep

    places, stepped = steps(reach, step), sweep(low, high, powers)
    _run("focus", rig, TABLES, out, settings, overwrite, lambda machines, progress: focus(
        machines, places, stepped, half_period=half_period, projector=projector, progress=progress))  # fmt: skip


@group.command
def axis(
    *, rig: Rig, out: Out = None, first: int = 0, stop: int | None = None, every: int = 1, repeats: int = 4,
    radius: float | None = None, flip_r: Switch = False, projector: Projector = 0, settings: Settings = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Find the roller's axis: columns are lit one after another, and a photodiode finds both edges of the shadow.

    Args:
        first: first column that is lit
        stop: column after the last lit one
        every: step from one lit column to the next
        repeats: number of readings of each
        radius: radius of the roller [columns], if only one edge can be scanned
        flip_r: set it if jobs are packed with flip_r
    """
    from vamgpu.hosts.calibrate.axis import TABLES, axis

    _run("axis", rig, TABLES, out, settings, overwrite, lambda machines, progress: axis(
        machines, first=first, stop=stop, every=every, repeats=repeats, radius=radius, flip_r=flip_r,
        projector=projector, progress=progress))  # fmt: skip


@group.command
def gray(
    *, rig: Rig, out: Out = None, every: int = 1, repeats: int = 4,
    reader: Literal["photodiode", "camera"] = "photodiode", settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Measure the gray curve of each projector.

    Args:
        every: step from one gray level to the next
        repeats: number of readings of each
        reader: instrument that reads the light
    """
    from vamgpu.hosts.calibrate.gray import gray, levels

    camera, steps = reader == "camera", levels(every)
    _run("gray", rig, (reader,), out, settings, overwrite, lambda machines, progress: gray(
        machines, steps, repeats=repeats, camera=camera, progress=progress))  # fmt: skip


@group.command
def flat(
    *, rig: Rig, out: Out = None, blocks: tuple[int, int] = (8, 12), repeats: int = 4,
    settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Measure how uniform each projector is at full drive, with a photodiode that collects all of its light.

    Keep everything out of the light during the measurement, including the roller.

    Args:
        blocks: number of mirror blocks along rows and columns, which are lit one after another
        repeats: number of readings of each
    """
    from vamgpu.hosts.calibrate.flat import TABLES, flat

    _run("flat", rig, TABLES, out, settings, overwrite, lambda machines, progress: flat(
        machines, blocks, repeats=repeats, progress=progress))  # fmt: skip


@group.command
def scatter(
    cuvettes: Path, *, out: Path | None = None, photons: Whole = None, settings: Settings = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Find scattering and absorption of a resin from light behind cuvettes of two or more thicknesses.

    Args:
        cuvettes: the TOML file of the readings, see docs/resin.md
        out: TOML file for [scattering] and [vial] of a job
        photons: number of photons that are followed through each cuvette; 200000 by default
    """
    from vamgpu.cli.show import show_rows
    from vamgpu.hosts.calibrate.report import free
    from vamgpu.jobs.cuvettes import CuvetteJob
    from vamgpu.optics.scattering_fit import PHOTONS
    from vamgpu.storage.atomic import replacing

    if out is not None:
        free(out, overwrite)
    found, screen = CuvetteJob.read(cuvettes, settings or ()).fitted(PHOTONS if photons is None else photons), console()
    show_rows(screen, found.lines(), 12)
    if out is not None:
        with replacing(out, overwrite=overwrite) as draft:
            draft.write_text(found.toml(), encoding="utf-8")
        screen.print(f"wrote [bold]{escape(str(out))}[/]")


@group.command(name="list")
def list_(*, rig: str, settings: Settings = None) -> None:
    """List the calibrations of a rig, newest first, and mark those that prints use.

    Args:
        rig: the TOML file of the rig
    """
    from vamgpu.hosts.rigs.calibrations import DAY, in_force, place_of, taken_of
    from vamgpu.hosts.rigs.config import read_rig

    screen, config = console(), read_rig(rig, settings or ())
    place = place_of(config)
    used, limit = {each.path for each in in_force(config).values()}, config.setup.calibration.warn_after / DAY
    for each in taken_of(config):
        state = "applied" if each.path in used else ""
        state += ", old: measure again" if state and each.days() > limit else ""
        screen.print(f"  {each.name:<27} {each.days():7.1f} days  [bold]{state}[/]")
    if not taken_of(config):
        screen.print(f"no calibrations in {escape(str(place))}; run vam calibrate gray, for instance")


@group.command
def mtf(
    *, rig: Rig, out: Path | None = None, at: Places = None, focused: Path | None = None, angle: float = 5.0,
    repeats: int = 4, projector: Projector = 0, settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Measure the sharpness (MTF) at several positions along the light, with a slanted edge.

    Args:
        out: folder of the result; beside the rig's file by default. beam.spread of a job may name it
        at: positions of the camera from its stage's center [mm]; 0, ±6 and ±15 by default
        focused: result of vam calibrate focus, used to focus on each position; by default the lens does not change
        angle: angle between the edge and the columns [deg]
        repeats: number of images that are averaged
    """
    from vamgpu.hosts.calibrate.mtf import POSITIONS, TABLES, mtf
    from vamgpu.hosts.calibrate.report import focused_at

    places = tuple(at) if at else POSITIONS
    powers = None if focused is None else focused_at(focused, places)
    tables = TABLES if powers is None else ("lens", *TABLES)
    _run("mtf", rig, tables, out, settings, overwrite, lambda machines, progress: mtf(
        machines, places, powers=powers, angle=angle, repeats=repeats, projector=projector,
        progress=progress))  # fmt: skip


@group.command
def runout(
    *, rig: Rig, out: Out = None, angles: int = 24, repeats: int = 2, speed: float = 30.0, projector: Projector = 0,
    settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Measure the runout of the turntable: a camera follows an upright pin near the axis over one turn.

    Args:
        angles: number of angles in the turn
        repeats: number of images at each angle, which are averaged
        speed: speed of the turntable from angle to angle [deg/s]
    """
    from vamgpu.hosts.calibrate.runout import TABLES, runout

    _run("runout", rig, TABLES, out, settings, overwrite, lambda machines, progress: runout(
        machines, poses=angles, repeats=repeats, speed=speed, projector=projector, progress=progress))  # fmt: skip


@group.command
def turn(
    *, rig: Rig, out: Out = None, turns: int = 10, speed: float = 40.0, settings: Settings = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Measure the vial's speed, and how far it turns per reported degree: a camera watches a mark on the vial.

    Args:
        turns: number of turns that are watched
        speed: speed of the vial [deg/s]
    """
    from vamgpu.hosts.calibrate.connection import opened_turn
    from vamgpu.hosts.calibrate.turn import turn

    _run("turn", rig, (), out, settings, overwrite, lambda machines, progress: turn(
        machines, speed=speed, turns=turns, progress=progress), opened_turn)  # fmt: skip


@group.command
def live(
    *, rig: Rig, out: Out = None, repeats: int = 8, keep_place: Switch = False, cured: Path | None = None,
    projector: Projector = 0, settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Measure the camera of watched prints: open field, dark level, noise, and where it sees each mirror.

    Without a vial, single columns and rows of mirrors are lit. Then put a vial of fresh resin in front of the camera's
    own light, and measure again with --keep-place, which lights no mirror.

    Args:
        repeats: number of images at each exposure time
        keep_place: keep the place of the last measurement
        cured: folder of a watched print in fresh resin, from whose images the turbidity is measured
    """
    from vamgpu.hosts.calibrate.live import PLACE, TABLES, live
    from vamgpu.hosts.rigs.calibrations import MEASURED, measured
    from vamgpu.hosts.rigs.config import read_rig

    config = read_rig(rig, settings or ())
    tables = TABLES if config.setup.camera_stage is None else (*TABLES, "camera_stage")
    place = {name: measured(config, "live").tables()[MEASURED][name] for name in PLACE} if keep_place else None
    turbidity = None if cured is None else _turbidity(cured)
    _run("live", rig, tables, out, settings, overwrite, lambda machines, progress: live(
        machines, repeats=repeats, projector=projector, place=place, turbidity=turbidity,
        progress=progress))  # fmt: skip


def _turbidity(cured: Path) -> MeasuredTurbidity:
    from vamgpu.live import LiveRecord
    from vamgpu.live.first_cure import turbidity_of

    return turbidity_of(LiveRecord(cured / "live" if (cured / "live").is_dir() else cured))


def _run(
    kind: str, rig: str, tables: tuple[str, ...], out: Path | None, settings: list[str] | None, overwrite: bool,
    measure: Callable[[Any, Callable[[float], None]], CalibrationResult],
    opening: Callable[[RigConfig], tuple[Any, Any]] | None = None,
) -> None:  # fmt: skip
    """Open the machines, measure, and write the result."""
    from rich.progress import Progress

    from vamgpu.hosts.calibrate.connection import opened, rehearsal
    from vamgpu.hosts.calibrate.report import free, keep, save
    from vamgpu.hosts.calibrate.truth import compared
    from vamgpu.hosts.rigs.calibrations import folder_of
    from vamgpu.hosts.rigs.config import read_rig

    screen, config = console(), read_rig(rig, settings or ())
    if out is None and folder_of(config) is None:
        out = Path(kind)
    if out is not None:
        free(out, overwrite)
    if opening is not None:
        stand, optics = opening(config)
    elif config.setup.emulated:
        stand, optics = rehearsal(config, tables, kind=kind)
    else:
        stand, optics = opened(config, tables), None
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
    place = keep(found, config).path if out is None else save(found, out, config.text, overwrite=overwrite)
    screen.print(f"result  [bold]{escape(str(place))}[/]")
