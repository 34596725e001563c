"""The commands ``vam import`` and ``vam export``."""

from __future__ import annotations

from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from rich.markup import escape

from vamgpu.cli.commands import app
from vamgpu.cli.options import Overwrite, Settings, Switch, console, solved_folder
from vamgpu.cli.show import shown_path
from vamgpu.errors import BadInput

if TYPE_CHECKING:
    from vamgpu.printing.export import Canvas
    from vamgpu.printing.frames import Frames


@app.command(name="import")
def import_(
    source: Path, /, *, out: Path | None = None, job: Path | None = None, patterns: Path | None = None,
    target: Path | None = None, flip_r: Switch = False, flip_z: Switch = False, reverse: Switch = False,
    axis: float | None = None, level: float | None = None, angles: int | None = None, gray: Path | None = None,
    machine: Annotated[Literal["tvam-code"] | None, Parameter(name="--for")] = None,
    device: str | None = None, settings: Settings = None, overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Convert another program's patterns to a job that you can prove, print or optimize further.

    Args:
        source: configuration of Dr.TVAM (JSON), sinogram of VAMToolbox (.sino, .npy), folder of PNG, TIFF or EXR
            images, patterns of TVAM-code (.npz or images), or a video, such as those that OpenCAL plays
        out: the folder; the source's name with .vam by default. If it ends in .toml, a job file for vam solve is
            written from the configuration of Dr.TVAM or a preset of VAMToolbox; it needs no patterns
        job: TOML file with what the source lacks: part, vessel, pixels
        patterns: pattern file of Dr.TVAM, if it is not in the folder of the configuration
        target: target voxels of VAMToolbox, in place of a mesh in the job
        flip_r: column 0 of images is the largest r
        flip_z: row 0 of images is the smallest z, as in videos of VAMToolbox
        reverse: images are in order of decreasing angle
        axis: column of the axis in images, counted from 0; by default their middle
        level: row of the part's middle; by default the images' middle
        angles: number of images per turn, if a video has several turns
        gray: TOML file with the gray curve for which the images were made
        machine: tvam-code, if images are as that program reads them: of 768 × 1024 pixels, with rows across the axis
        device: where to compute; the best device here by default
    """
    from vamgpu.cli.progress import shown
    from vamgpu.jobs.foreign.importing import import_patterns, import_task
    from vamgpu.jobs.foreign.pictures import Layout
    from vamgpu.printing.gray import GrayCurve
    from vamgpu.storage.atomic import named

    if out is not None and out.suffix.lower() == ".toml":
        if beside := [name for name, value in (("--job", job), ("--patterns", patterns), ("--target", target),
                                               ("--set", settings)) if value is not None]:  # fmt: skip
            raise BadInput(f"got {', '.join(beside)} with --out {out}; a job file is made from the configuration "
                           "alone: leave it out")  # fmt: skip
        for note in import_task(source, out, overwrite=overwrite):
            console().print(f"[yellow]note[/]  {escape(note)}")
        console().print(f"wrote [bold]{shown_path(out)}[/]; solve it with: vam solve {shown_path(out)}")
        return
    curve = None if gray is None else GrayCurve.load(gray)
    layout, screen = Layout(flip_r, flip_z, reverse, axis, level, angles, curve, machine is not None), console()
    place = out if out is not None else named(source).with_suffix(".vam")
    with shown(screen) as progress:
        done = import_patterns(
            source, place, job=job, settings=settings or (), patterns=patterns, target=target, layout=layout,
            device=device, overwrite=overwrite, progress=progress,
        )  # fmt: skip
    for note in done.notes:
        screen.print(f"[yellow]note[/]  {escape(note)}")
    screen.print(
        f"wrote [bold]{shown_path(place)}[/] from {done.program}; prove it with: vam prove {shown_path(place)}"
    )


@app.command
def export(
    job: Path, *, png: Path | None = None, tiff: Path | None = None, npz: Path | None = None, mp4: Path | None = None,
    drtvam: Path | None = None, fps: float | None = None, players: Switch = False, canvas: str | None = None,
    offset: tuple[int, int] = (0, 0), rotation: float = 0.0, flip_r: Switch = False, flip_z: Switch = False,
    repeats: int = 1, rig: Path | None = None, projector: int = 1,
    machine: Annotated[str | None, Parameter(name="--for")] = None, out: Path | None = None, rpm: float | None = None,
    dark: tuple[float, float] | None = None, channel: str | None = None, keystone: str | None = None,
    overwrite: Overwrite = False,
) -> None:  # fmt: skip
    """Write the frames of a job as files for other programs.

    Args:
        job: the job folder
        png: a folder of PNG images
        tiff: one file with one page per frame
        npz: one file with bytes, curve and settings for NumPy
        mp4: a video: lossless in gray, or with --players for any player
        drtvam: a folder for Dr.TVAM, with configuration, patterns and part
        fps: frames per second of the video, 30 by default; those of a [travel] with a period follow from it
        players: write the video in yuv420p, which projectors and common players decode
        canvas: columns and rows of the images, such as 1920x1080; frames are centered in them
        offset: shift of the frames from that center: columns to the right, rows upwards
        rotation: rotation of the frames, counterclockwise [deg]
        flip_r: mirror frames left to right
        flip_z: mirror frames top to bottom
        repeats: number of turns; 1 for a part that moves, whose turns are those of [travel]
        rig: TOML file of a rig; frames are made for its gray curve, flat field and axis
        projector: number of the projector of that rig, from 1
        machine: machine to write a film and a card for: opencal, tvam-code, tvam-code-images, rotary or lightcrafter;
            needs --out and --rpm, and --repeats sets the number of turns
        out: the folder for this film and card
        rpm: speed of that machine's turntable; in videos it gives the frames per second, in place of --fps
        dark: seconds without light before and after the turns of its film, in whole turns; 5 and 10 s by default
        channel: the only channel of a video that is lit: red, green or blue
        keystone: pixels, "column,row", at which the left top, right top, right bottom and left bottom corners of the
            canvas are drawn
    """
    from vamgpu.jobs.foreign.drtvam import export_drtvam
    from vamgpu.methods.plan_folder import load_plan, operator_from
    from vamgpu.printing.export import Canvas
    from vamgpu.printing.export import export as write
    from vamgpu.printing.folder import frames_of
    from vamgpu.printing.machine_films import export_for
    from vamgpu.storage.folder import Folder

    places = _places({"": png, ".tiff": tiff, ".npz": npz, ".mp4": mp4})
    if not places and drtvam is None and machine is None:
        raise BadInput("there is no format; expected at least one of --png, --tiff, --npz, --mp4, --drtvam with a "
                       "path, or --for with a machine")  # fmt: skip
    if machine is not None and (out is None or rpm is None):
        raise BadInput(f"--for {machine} lacks {'--rpm' if out else '--out'}; expected --out FOLDER --rpm SPEED")
    job = solved_folder(job, "export")
    screen, frames = console(), _frames(job, rig, projector)
    moves = getattr(frames.motion, "travel", None) is not None
    if moves and (machine is not None or drtvam is not None):
        raise BadInput(f"got {'--drtvam' if machine is None else f'--for {machine}'}, which repeats one turn, with a "
                       "part that moves (travel); expected --mp4 or --png, for the frames of all turns")  # fmt: skip
    rate = _rate(frames, fps, rpm)
    shown = frames.followed(operator_from(Folder.open(job), frames.device).beam) if moves else frames
    placed = Canvas(_size(canvas), offset, rotation, flip_r, flip_z, repeats, keystone=_corners(keystone))
    if moves:
        _check_path(shown, placed)
    for ending, place in places.items():
        film = {"players": players, "channel": channel} if ending == ".mp4" else {}
        film["canvas"] = None if placed == Canvas() else placed
        done = write(shown, place, fps=rate or 30.0, overwrite=overwrite, **film)
        screen.print(f"wrote [bold]{shown_path(done)}[/]")
    if machine is not None and out is not None and rpm is not None:
        for done in export_for(machine, frames, out, job.stem, rpm=rpm, canvas=placed, dark=dark, channel=channel,
                               overwrite=overwrite):  # fmt: skip
            screen.print(f"wrote [bold]{shown_path(done)}[/]")
    if drtvam is not None:
        if placed != Canvas():
            raise BadInput("--drtvam writes the patterns themselves; expected no canvas, rotation, flips or repeats: "
                           "leave them out, or export for a machine with --for")  # fmt: skip
        whole = frames_of(Folder.open(job), frames.device, load_plan(job, frames.device))
        screen.print(f"wrote [bold]{shown_path(export_drtvam(whole, drtvam))}[/]")


def _places(formats: dict[str, Path | None]) -> dict[str, Path]:
    """Ending → path of each requested file. Raises `BadInput`."""
    places = {ending: place for ending, place in formats.items() if place is not None}
    for ending, place in places.items():
        if place.suffix.lower() not in {ending, ending.replace("tiff", "tif")}:
            raise BadInput(f"got {str(place)!r}; expected a path with {f'ending {ending}' if ending else 'no ending'}")
    return places


def _rate(frames: Frames, fps: float | None, rpm: float | None) -> float | None:
    """Frames per second of a video: those asked for, or of a path with a period. Raises `BadInput` if they differ."""
    if fps is not None and rpm is not None:
        raise BadInput(f"got --fps {fps:g} and --rpm {rpm:g}; both give the speed of videos: leave one of them out")
    angles = frames.shape[0] if frames.motion is None else frames.motion.angles
    rate = fps if rpm is None else rpm * angles / 60.0
    period = getattr(getattr(frames.motion, "travel", None), "period", None)
    if period is not None and rate is not None and not isclose(rate, angles / period, rel_tol=1e-3):
        got = f"--fps {fps:g}" if rpm is None else f"--rpm {rpm:g}"
        raise BadInput(f"got {got}, and a turn of [travel] takes {period:g} s; expected --fps {angles / period:.4g} or "
                       f"--rpm {60.0 / period:.4g}: leave it out, or solve the job with another period")  # fmt: skip
    return rate if period is None else angles / period


def _check_path(frames: Frames, canvas: Canvas) -> None:
    """Raise `BadInput` unless the frames of all turns are shown once, on a canvas with as many rows."""
    if canvas.repeats != 1:
        raise BadInput(f"--repeats is {canvas.repeats}, and these are the frames of all turns of [travel]; expected 1: "
                       "the part would jump back to where it began")  # fmt: skip
    across = round(canvas.rotation / 90) % 2
    lacks = 0 if canvas.size is None else frames.shape[1] - canvas.size[1 - across]
    if lacks > 0:
        raise BadInput(f"the canvas lacks {lacks} rows: along [travel], light falls on {frames.shape[1]} rows; "
                       "expected them all on the canvas: use a larger one, or a shorter path")  # fmt: skip


def _size(canvas: str | None) -> tuple[int, int] | None:
    """Columns and rows in text such as 1920x1080. Raises `BadInput`."""
    if canvas is None:
        return None
    columns, _, rows = canvas.lower().replace("×", "x").partition("x")
    if not (columns.strip().isdecimal() and rows.strip().isdecimal()):
        raise BadInput(f"--canvas is {canvas!r}; expected columns and rows, such as 1920x1080")
    return int(columns), int(rows)


def _corners(text: str | None) -> tuple[tuple[float, float], ...] | None:
    """Four corners of text such as "0,12 1919,0 1919,1079 0,1070". Raises `BadInput`."""
    if text is None:
        return None
    try:
        return tuple((float(x), float(y)) for x, y in (corner.split(",") for corner in text.split()))
    except ValueError as error:
        raise BadInput(f"--keystone is {text!r}; expected four corners such as 0,12 1919,0 1919,1079 0,1070") from error


def _frames(job: Path, rig: Path | None, projector: int) -> Frames:
    """Frames of a job, corrected by the calibrations of a rig's projector if there is one. Raises `BadInput`."""
    from vamgpu.jobs.web import is_web_folder
    from vamgpu.printing.folder import load_frames

    if is_web_folder(job):
        raise BadInput(
            f"{str(job)!r} is a web, whose frames have no end; expected the folder of a vial's job: in Python, "
            "get the frames of a web one by one with vamgpu.webs.store.WebFolder.open(path).frame(number)"
        )
    frames = load_frames(job, "numpy")
    if rig is None:
        return frames
    from vamgpu.hosts.rigs.calibrations import calibration_of
    from vamgpu.hosts.rigs.config import read_rig

    config = read_rig(rig)
    if not 1 <= projector <= len(config.setup.display):
        raise BadInput(f"--projector is {projector}; the rig has {len(config.setup.display)}, counted from 1")
    return calibration_of(config).frames(frames, projector - 1)
