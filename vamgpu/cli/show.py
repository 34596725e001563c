"""Results of commands on the terminal."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

if TYPE_CHECKING:
    from vamgpu.printing.proof import Proof
    from vamgpu.printing.verdict import Verdict
    from vamgpu.webs.proof import WebProof


def shown_path(path: Path) -> str:
    """A path as text; its brackets are escaped."""
    return escape(str(path))


def show_verdict(screen: Console, verdict: Verdict) -> None:
    """Show whether the part prints, and what to do if it does not."""
    color = ("green" if verdict.proved else "yellow") if verdict.prints else "red"
    rest = verdict.sentence.removeprefix(verdict.opening)
    screen.print(f"[bold {color}]{verdict.opening}[/]{escape(rest)}")
    for remedy in verdict.remedies:
        screen.print(f"  → {escape(remedy)}")
    for what in verdict.not_judged:
        screen.print(f"  not judged: {escape(what)}")


def show_rows(screen: Console, rows: Iterable[tuple[str, str, str]], width: int = 22) -> None:
    """Names, values and meanings, one line each."""
    for name, value, meaning in rows:
        screen.print(f"  {name:<27} [bold]{value:<{width}}[/] [dim]{escape(meaning)}[/]")


def report_memory(memory: str | None, proof: Proof) -> int:
    """Memory of a verdict and a report [bytes] if it exceeds the limit of the process; else 0."""
    from vamgpu.printing.report import report_bytes
    from vamgpu.quantity import bytes_of

    needs = report_bytes(proof)
    return 0 if memory is None or needs <= (bytes_of(memory) or 0) else needs


def show_web(screen: Console, proof: WebProof) -> None:
    """The numbers of a web."""
    last = proof.segments[-1].columns[1]
    rows = (
        ("overlap (IoU)", f"{proof.iou:.4f}", f"at one threshold, {proof.threshold:.3f} of the expected dose"),
        ("narrowest window", f"{proof.window:+.4f}", "(least dose in the part - greatest outside) / greatest"),
        ("printed", f"{last * proof.grid.edges[0]:.4g} mm", f"{len(proof.segments)} segments, {last} columns"),
    )
    show_rows(screen, rows)
