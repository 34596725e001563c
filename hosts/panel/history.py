"""Past prints: the run folders in one folder."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from vamgpu.hosts.process.messages import running
from vamgpu.hosts.records.state import PrintState
from vamgpu.storage.reading import open_file, parse_json, read_text

NEWEST = 50  # most prints listed
LAST = 4096  # bytes at a file's end that are searched for its last line
LARGEST = 1 << 20  # greatest number of bytes read of a file
REPORT = re.compile(r"(live|report(-\d+)?)\.html")


def past(place: Path, own: str | None = None) -> list[dict[str, Any]]:
    """The prints in a folder, newest first, from their small files, without unreadable ones. own: this print."""
    found = []
    try:
        folders = [(each.stat().st_mtime, each.parent) for each in place.glob("*/state.json")]
    except OSError:
        return []
    for _, folder in sorted(folders, reverse=True)[:NEWEST]:
        try:
            found.append(_told(folder, own))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
    return found


def report(place: Path, run: str, name: str) -> Path | None:
    """A report of a listed print; None if there is none, or if the path leads outside."""
    listed = next((each for each in place.glob("*/state.json") if each.parent.name == run), None)
    if listed is None or not REPORT.fullmatch(name):
        return None
    page = listed.parent / name
    return page if page.is_file() and not page.is_symlink() else None


def _told(folder: Path, own: str | None) -> dict[str, Any]:
    state, asked = _json(folder / "state.json"), _json(folder / "run.json")
    timing = _json(folder / "timing.json") if (folder / "timing.json").is_file() else {}
    began, last = _walls(folder / "events.jsonl")
    end = float(state["wall"])
    return {
        "name": folder.name,
        "job": ", ".join(Path(str(each)).name for each in asked["jobs"]),
        "state": str(state["state"]),
        "message": str(state["message"]),
        "began": end if began is None else began,
        "seconds": 0.0 if began is None else max(end, last or end) - began,
        "doubt": timing.get("light", {}).get("in_doubt", 0),
        "running": folder.name != own and not PrintState(state["state"]).ended and running(folder),
        "reports": sorted(each.name for each in folder.glob("*.html") if REPORT.fullmatch(each.name)),
    }


def _json(path: Path) -> dict[str, Any]:
    return dict(parse_json(read_text(path, LARGEST)))


def _walls(path: Path) -> tuple[float | None, float | None]:
    """The time of the first and of the last event [s since 1970]."""
    with open_file(path) as file:
        first = file.readline(LAST)
        file.seek(max(0, path.stat().st_size - LAST))
        lines = file.read(LAST).split(b"\n")
    return _wall(first), next(filter(None, map(_wall, reversed(lines))), None)


def _wall(line: bytes) -> float | None:
    try:
        return float(parse_json(line)["wall"])
    except (ValueError, KeyError, TypeError):
        return None
