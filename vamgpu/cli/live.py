"""The commands ``vam live replay`` and ``vam live film``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cyclopts import App
from rich.markup import escape

from vamgpu.cli.options import console
from vamgpu.errors import BadInput
from vamgpu.quantity import counted

group: App = App(name="live", help="Replay prints that a camera watched, or make videos of them.")


@group.command
def replay(run: Path, /) -> None:
    """Repeat the decision of every turn of a recorded print, and report whether each is the same, bit for bit.

    Also show how long each stage took during the print, and the turn from which each decision took effect.

    Args:
        run: folder of the run
    """
    from vamgpu.live import LiveRecord
    from vamgpu.live.record import budget

    screen, otherwise, decisions = console(), [], []
    for decision, differs in LiveRecord(_place(run)).replay():
        decisions.append(decision)
        same = f"differs in {', '.join(differs)}" if differs else "same"
        more = (
            f"{counted(decision['turns'], 'turn')} to go, overlap {decision['iou']:.4f}"
            if decision["parameters"]
            else decision["reason"]
        )
        screen.print(
            f"turn {decision['turn']:3}  {decision['action']:4}  patterns {decision['version']}  {escape(more)}  "
            f"[bold]{same}[/]"
        )
        otherwise += [decision["turn"]] if differs else []
    for stage, median, most, count in budget(decisions):
        screen.print(f"{stage:8}  {median:7.3f} s, at most {most:7.3f} s, in {count} decisions")
    for name, line in _effective(decisions):
        screen.print(f"{name:8}  {line}")
    if otherwise:
        turns = ", ".join(map(str, otherwise))
        raise BadInput(f"{str(run)!r} reaches other decisions than its record in turns {turns}; expected the same: "
                       "replay it on the device and with the version of vamgpu that recorded it")  # fmt: skip


@group.command
def film(run: Path, /, out: Path = Path("live.mp4"), rate: float = 1.0) -> None:
    """Make a video of a recorded print: camera image, dose, conversion and decision of each turn.

    Args:
        run: folder of the run
        out: path of the video, ending in .mp4; its folder must exist
        rate: turns per second
    """
    from vamgpu.live import LiveRecord
    from vamgpu.live.film import film as drawn

    made = drawn(LiveRecord(_place(run)), out, rate)
    console().print(f"video   [bold]{escape(str(made))}[/]")


def _place(run: Path) -> Path:
    inside = run / "live"  # of a print on a rig
    return inside if inside.is_dir() else run


def _effective(decisions: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """After how many turns swaps took effect, and which ones never did."""
    swaps = [decision for decision in decisions if decision["action"] == "swap" and "effective" in decision]
    shown = [decision["effective"] - decision["turn"] for decision in swaps if decision["effective"] is not None]
    if shown:
        yield "shown", f"{len(shown)} of {len(swaps)} swaps, at most {counted(max(shown), 'turn')} after the last image"
    late = [str(decision["turn"]) for decision in swaps if decision["effective"] is None]
    if late:
        yield "late", f"swaps of turns {', '.join(late)} never took effect"
