"""Frames as the machines of labs play them, with a card that says at which speed to turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.printing.export import Canvas, export
from vamgpu.quantity import counted, positive
from vamgpu.storage.atomic import check_folder, replacing
from vamgpu.storage.images import encode_png

if TYPE_CHECKING:
    from vamgpu.printing.frames import Frames

HDMI = 60.0  # images per second that projectors show
DARK = (5.0, 10.0)  # seconds without light before and after the turns of a film


@dataclass(frozen=True)
class Machine:
    """A machine: size, rate and stage speed [rpm] of its films, function that writes them, notes for users."""

    # dark: default seconds before and after the turns; None if its files hold one turn of light alone. write: also
    # describes the levels.

    size: tuple[int, int]
    fastest: float
    speed: float
    dark: tuple[float, float] | None
    write: Callable[[Film, Path], tuple[Path, str]]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Film:
    """Frames for a machine: speed [rpm], placement with dark images and turns, and the channel that is lit."""

    frames: Frames
    name: str
    rpm: float
    canvas: Canvas
    channel: str | None
    overwrite: bool

    @property
    def fps(self) -> float:
        """Images per second."""
        return self.rpm * self.frames.shape[0] / 60.0


def export_for(
    machine: str, frames: Frames, folder: str | Path, name: str, *, rpm: float, canvas: Canvas = Canvas(),
    dark: tuple[float, float] | None = None, channel: str | None = None, overwrite: bool = False,
) -> tuple[Path, Path]:  # fmt: skip
    """Write frames as the files of one of `MACHINES`, and a card; both paths. Raises `BadInput`, `StorageError`."""
    # dark: seconds without light before and after, made whole turns: a film in a loop then begins at the same angle
    if machine not in MACHINES:
        raise BadInput(f"no machine {machine!r}; expected one of {', '.join(MACHINES)}")
    kind, motion = MACHINES[machine], frames.motion
    if motion is not None and not motion.is_even:
        raise BadInput(f"got frames of {motion}; expected equal angles and times over a full turn, as in every film")
    turn = 60.0 / positive("rpm", rpm)
    asked = dark or kind.dark or (0.0, 0.0)
    before, after = (ceil(positive("seconds of dark", each, zero=True) / turn - 1e-9) for each in asked)
    if kind.dark is None and (before or after):
        raise BadInput(f"dark is {dark}; expected none: the files for {machine} hold one turn, without dark images")
    if kind.dark is not None and not after:
        raise BadInput(f"dark is {dark}; expected seconds above 0 after the last turn: a film that ends lit "
                       "continues to cure at its last angle, or starts again")  # fmt: skip
    lit = replace(canvas, size=canvas.size or kind.size, dark=(before * frames.shape[0], after * frames.shape[0]))
    film = Film(frames, name, rpm, lit, channel, overwrite)
    most = min(kind.speed, 60.0 * kind.fastest / frames.shape[0])
    if rpm > most * (1.0 + 1e-9):
        raise BadInput(f"{frames.shape[0]} frames per turn at {rpm:g} rpm are {film.fps:.4g} images per second; "
                       f"{machine} shows {kind.fastest:g} and turns at {kind.speed:g} rpm at most: use {most:.4g} rpm "
                       "or less, or fewer angles")  # fmt: skip
    check_folder(Path(folder) / name)
    made, levels = kind.write(film, Path(folder))
    card = made.with_name(f"{made.stem}.txt")
    with replacing(card, overwrite=overwrite) as draft:
        draft.write_text(_card(film, machine, made, levels), encoding="utf-8")
    return made, card


def _card(film: Film, machine: str, made: Path, levels: str) -> str:
    """Settings of the machine, and notes for its operator."""
    n, canvas, turn = film.frames.shape[0], film.canvas, 60.0 / film.rpm
    before, after = (each // n for each in canvas.dark)
    light, seconds = f"{counted(canvas.repeats, 'turn')} of {counted(n, 'frame')}", f"{canvas.repeats * turn:.6g} s"
    dark = [f"{counted(each, 'turn')} ({each * turn:.6g} s)" for each in (before, after)]
    lines = [
        f"{made.name} for {machine}",
        f"turn at     {film.rpm:g} rpm = {6.0 * film.rpm:g} deg/s, one turn in {turn:.6g} s",
        f"light       {light}, {film.fps:.6g} frames per second, {seconds}",
        f"dark        {dark[0]} before, {dark[1]} after" if after else "dark        none in the files",
        f"image       {canvas.size[0]} x {canvas.size[1]} pixels, light in {film.channel or 'all channels'}"
        if canvas.size else "",
        f"levels      {levels}",
    ]  # fmt: skip
    words = {"turns": canvas.repeats, "times": counted(canvas.repeats, "time")}
    words |= {"speed": 6.0 * film.rpm, "name": made.name}
    notes = (note.format(**words) for note in MACHINES[machine].notes)
    return "\n".join([*lines, *notes, ""])


def _film(film: Film, place: Path) -> tuple[Path, str]:
    made = export(film.frames, place, fps=film.fps, overwrite=film.overwrite, canvas=film.canvas,
                  players=film.channel is None, channel=film.channel)  # fmt: skip
    return made, f"gray curve: {film.frames.gray}"


def _opencal(film: Film, folder: Path) -> tuple[Path, str]:
    """OpenCAL reads the speed from the name, in whole rpm."""
    if film.rpm != int(film.rpm):
        raise BadInput(f"rpm is {film.rpm:g}; expected a whole number, which OpenCAL reads from the name of the film")
    return _film(film, folder / f"{film.name}_{int(film.rpm)}rpm.mp4")


def _tvam_code(film: Film, folder: Path) -> tuple[Path, str]:
    place, (levels, said) = folder / f"{film.name}-tvam.npz", _linear(film)
    with replacing(place, overwrite=film.overwrite) as draft, draft.open("wb") as file:
        np.savez_compressed(file, patterns=levels)
    return place, said


def _tvam_images(film: Film, folder: Path) -> tuple[Path, str]:
    """TVAM-code reads every file of a folder as an image."""
    place, (levels, said) = folder / f"{film.name}-tvam", _linear(film)
    with replacing(place, overwrite=film.overwrite) as draft:
        draft.mkdir()
        for number, image in enumerate(levels):
            (draft / f"{number:04d}.png").write_bytes(encode_png(image))
    return place, said


def _linear(film: Film) -> tuple[np.ndarray, str]:
    """Linear levels [angle, r, z] of one turn, none dark, and what they are: TVAM-code switches the light itself."""
    gray = film.frames.gray
    light = [gray(image.T) - gray.black for image in replace(film.canvas, repeats=1).images(film.frames)]
    most = max(float(each.max()) for each in light)
    if most <= 0.0:
        raise BadInput("every frame is dark; expected some light")
    levels = np.stack([np.rint(each * (255.0 / most)).astype(np.uint8) for each in light])
    share = most / (1.0 - gray.black)
    return levels, (
        f"linear in light; 255 is the brightest pixel, which has {share:.4g} of full light: {1.0 / share:.4g} times "
        f"the dose,\n            unless you dim the projector to {share:.4g}, or make {share:.4g} of the turns"
    )


def _lightcrafter(film: Film, folder: Path) -> tuple[Path, str]:
    """Images of 24 bits with three frames each, in the order in which the controller takes them: green, red, blue."""
    place, n = folder / f"{film.name}-lightcrafter", film.frames.shape[0]
    if n % 3:
        raise BadInput(f"got {n} frames per turn; expected a multiple of 3, because an image of a LightCrafter holds "
                       f"three frames of one turn: solve with {n + 3 - n % 3} angles")  # fmt: skip
    with replacing(place, overwrite=film.overwrite) as draft:
        draft.mkdir()
        images = replace(film.canvas, repeats=1).images(film.frames)
        for number, (first, second, third) in enumerate(zip(images, images, images, strict=True)):
            colors = np.stack([second, first, third], 2)
            (draft / f"{number:04d}.png").write_bytes(encode_png(colors))
    return place, f"gray curve: {film.frames.gray}"


_TVAM_CODE = Machine((768, 1024), 290.0, 20.0, None, _tvam_code, (
    "python tvam_code.py -p {name} -v {speed:g} -n {turns}",
    "The stage's steps per turn must be a multiple of twice the number of images; the light starts after one turn.",
))  # fmt: skip
MACHINES = {
    "opencal": Machine((1920, 1080), HDMI, 60.0, DARK, _opencal, (
        "OpenCAL takes the speed from the name, turns counterclockwise and plays the film again and again:",
        "stop the print in the dark after the last turn.",
    )),
    "tvam-code": _TVAM_CODE,
    "tvam-code-images": replace(_TVAM_CODE, write=_tvam_images),
    "rotary": Machine((1920, 1080), HDMI, 600.0, DARK, lambda film, folder: _film(film, folder / f"{film.name}.mp4"), (
        "Start the turntable before the film; the film ends in the dark.",
    )),
    "lightcrafter": Machine((912, 1140), 120.0, 600.0, None, _lightcrafter, (
        "Each image holds three frames of 8 bits, in green, red and blue: show them in this order, {times}.",
        "Switch the light off after the last turn.",
    )),
}  # fmt: skip
"""Name → machine, by its published data."""
