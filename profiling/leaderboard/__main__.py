"""Run the programs on the parts, judge their frames, and write the record and the page.

    python -m profiling.leaderboard --parts boat gear --vials matched air
    python -m profiling.leaderboard --parts               # only the page, from the record and the pictures in `out`

What the record already has is not run again. With --judge-again, the frames in `out` are judged again. With --again,
entries solve again as well, for example `--entries ours ours-limited --again` after a change of the default.
"""

from __future__ import annotations

import argparse
import json
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from profiling.common import HERE, machine, write_record
from profiling.leaderboard import page
from profiling.leaderboard.cases import VIALS, make
from profiling.leaderboard.entries import ENTRIES, RESULT
from profiling.leaderboard.judge import Exposure, Setup, read_frames
from profiling.leaderboard.parts import PARTS
from profiling.leaderboard.scores import Part, read_stl, scores

SIZE, ANGLES = 24.0, 360
ROUNDS = 3
"""Most solutions with ever shorter exposures, until the judge finds one as short as that of the fastest program."""


class Judged:
    """A case, whose entries are judged one after the other."""

    def __init__(self, folder: Path, again: bool = False) -> None:
        self.folder, self.setup, self.again = folder, Setup.load(folder / "judge.toml"), again
        shape = json.loads((folder / "frames.json").read_text(encoding="utf-8"))
        self.exposure = Exposure(self.setup, (shape["angles"], shape["columns"], shape["rows"]))
        self.part = Part(self.exposure, read_stl(self.setup.part))

    def solved(self, entry: str, place: str, options: tuple[str, ...] = ()) -> dict[str, Any]:
        """Facts and scores of an entry that solves the case in a folder, with a picture of its worst place there."""
        if self.again:
            (self.folder / place / RESULT).unlink(missing_ok=True)
        facts = ENTRIES[entry].run(self.folder, self.folder / place, options)
        if "missing" in facts:
            return facts
        light = read_frames(self.folder / place / "frames")
        rate = self.exposure.dose_rate(light)
        found = scores(self.part, light, rate)
        page.keep_worst(self.folder / place / "worst.npz", self.part, rate / found["threshold"])
        return facts | found


def run(args: argparse.Namespace, record: dict[str, Any]) -> None:
    """All that the record lacks."""
    for vial in args.vials:
        for part in args.parts:
            name = f"{part}, {vial}"
            folder = make(args.work / name.replace(", ", "-").replace(" ", "-"), part, vial, args.size, args.angles)
            judged = Judged(folder, args.again)
            case = record["cases"].setdefault(name, {"frames": list(judged.exposure.shape), "entries": {}})
            case |= {"judge_voxels": list(judged.part.solid.shape), "counts": vars(judged.part.counts),
                     "pixel_mm": judged.part.pixel}  # fmt: skip
            for entry in sorted(args.entries, key=page.LIMITED.__eq__):  # it needs the results of the others
                for seconds in args.seconds if entry != page.LIMITED else [0.0]:
                    _run(judged, entry, seconds, case, args.judge_again or args.again)
                    write_record(args.records, f"leaderboard-{args.label}", record)


def _run(judged: Judged, entry: str, seconds: float, case: dict[str, Any], again: bool) -> None:
    known, key = case["entries"].setdefault(entry, {}), f"{seconds:g}"
    if "missing" not in known.get(key, {"missing": ""}) and not again:
        return
    if entry == page.LIMITED:
        facts = _limited(judged, case)
    elif seconds:
        facts = judged.solved(entry, f"{entry}-{key}", ("--seconds", key))
    else:
        facts = judged.solved(entry, entry)
    known[key] = page.rounded(facts)
    print(judged.folder.name, entry, key, json.dumps(known[key]), flush=True)


def _limited(judged: Judged, case: dict[str, Any]) -> dict[str, Any]:
    """Ours, with an exposure no longer than that of the fastest other program; the default, if its own is not."""
    runs = [each.get(page.DOCUMENTED, {}) for name, each in case["entries"].items() if ENTRIES[name].home]
    longest = aim = min((each["seconds"] for each in runs if "seconds" in each), default=inf)
    facts = dict(case["entries"].get(page.OURS, {}).get(page.DOCUMENTED, {}))
    for _ in range(ROUNDS if facts.get("seconds", inf) > longest else 0):
        facts = judged.solved(page.LIMITED, f"{page.LIMITED}-{aim:.3g}", ("--longest", f"{aim:.3g}"))
        if facts.get("seconds", 0.0) <= longest:
            break
        aim *= 0.99 * longest / facts["seconds"]
    return facts


def main() -> None:
    parser = argparse.ArgumentParser(
        "python -m profiling.leaderboard", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", nargs="*", choices=list(PARTS), default=list(PARTS))
    parser.add_argument("--vials", nargs="+", choices=list(VIALS), default=list(VIALS))
    parser.add_argument("--entries", nargs="+", choices=list(ENTRIES), default=list(ENTRIES))
    parser.add_argument(
        "--seconds", nargs="+", type=float, default=[0.0], help="processor seconds; 0: each as documented"
    )
    parser.add_argument("--judge-again", action="store_true")
    parser.add_argument("--again", action="store_true", help="solve again, too")
    parser.add_argument("--size", type=float, default=SIZE, help="pixels in the resin that make a part's radius")
    parser.add_argument("--angles", type=int, default=ANGLES)
    parser.add_argument("--work", type=Path, default=Path("out/leaderboard"), help="folder for cases and frames")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="cpu")
    args = parser.parse_args()
    path = args.records / f"leaderboard-{args.label}.json"
    record: dict[str, Any] = {"size": args.size, "angles": args.angles, "machine": machine(), "cases": {}}
    if path.exists():
        record |= {"cases": json.loads(path.read_text(encoding="utf-8"))["cases"]}
    run(args, record)
    page.write(HERE.parent / "docs", record, args.work)


if __name__ == "__main__":
    np.seterr(invalid="ignore")
    main()
