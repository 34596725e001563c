"""The page docs/compared.md: tables of the record, and the worst place of every entry."""

from __future__ import annotations

import re
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from profiling.common import HERE
from profiling.leaderboard.cases import VIALS
from profiling.leaderboard.entries import ENTRIES
from profiling.leaderboard.scores import Part
from vamgpu.quantity import counted
from vamgpu.reports import style

OURS, LIMITED = "ours", "ours-limited"
PLACES = {"matched": "in a matched vial", "air": "in air", "square": "in a square vial"}
DOCUMENTED = "0"
REMARKS = HERE / "leaderboard" / "remarks.md"
"""What is known about the reasons; it is read by people, and written by them."""
SCORES: dict[str, tuple[str, str, int]] = {
    "wrong": ("wrong bodies and holes", ".0f", 1),
    "rms_um": ("RMS [µm]", ".0f", 1),
    "p95_um": ("95 % [µm]", ".0f", 1),
    "W0.5": ("W(½)", "+.3f", -1),
    "W1": ("W(1)", "+.3f", -1),
    "latitude": ("latitude [%]", ".1f", -1),
    "stray": ("stray [%]", ".2f", 1),
    "seconds": ("exposure [s]", ".1f", 1),
    "energy_mJ": ("energy [mJ]", ".1f", 1),
    "processor_s": ("processor [s]", ".1f", 1),
    "memory_gb": ("memory [GB]", ".2f", 1),
}
"""Header, format, and whether less (1) or more (-1) is better."""
SHARES = ("latitude", "stray")
ALIKE = 0.02
"""Relative difference below which two scores count as equal."""


def rounded(value: Any) -> Any:
    """Numbers of five digits; None in place of those that are none."""
    if isinstance(value, dict):
        return {name: rounded(each) for name, each in value.items()}
    if isinstance(value, float | np.floating):
        return float(f"{value:.5g}") if isfinite(value) else None
    return value


def keep_worst(path: Path, part: Part, dose: np.ndarray) -> None:
    """Keep the slice with the voxel that is wrong farthest from the surface: dose over the threshold, and depth."""
    wrong = np.where(((dose >= 1.0) != (part.depth > 0.0)) & part.judged, np.abs(part.depth), 0.0)
    i, j, k = np.unravel_index(int(wrong.argmax()), wrong.shape)
    np.savez_compressed(path, dose=dose[:, :, k].astype(np.float32), depth=part.depth[:, :, k].astype(np.float32),
                        place=np.array([i, j, k]), deepest=wrong.max())  # fmt: skip


def write(docs: Path, record: dict[str, Any], work: Path) -> None:
    """Write the page and its pictures."""
    blocks = [_head(record), *filter(None, (_standing(record, entry) for entry in (OURS, LIMITED)))]
    for name, case in sorted(record["cases"].items(), key=lambda each: list(VIALS).index(each[0].split(", ")[1])):
        columns, rows = case["frames"][1:]
        counts = case["counts"]
        blocks += [
            f"## {name[0].upper()}{name[1:]}",
            f"{record['angles']} images of {columns} × {rows} pixels, "
            f"{1e3 * case['pixel_mm']:.0f} µm wide in the resin. "
            f"On the judge's voxels the part has {counts['bodies']} bodies, {counts['holes']} holes and "
            f"{counts['cavities']} cavities.",
            _table(case, DOCUMENTED),
        ]
        budgets = sorted({float(key) for each in case["entries"].values() for key in each} - {0.0})
        blocks += [_table(case, f"{budget:g}", True) for budget in budgets]
        if picture := _picture(docs, name, case, work / name.replace(", ", "-").replace(" ", "-")):
            blocks.append(f"![The worst place of each entry: {name}]({picture})")
    if REMARKS.exists():
        blocks.append(REMARKS.read_text(encoding="utf-8").strip())
    (docs / "compared.md").write_text("\n\n".join(blocks) + "\n", encoding="utf-8")


def _head(record: dict[str, Any]) -> str:
    """The words of head.md around what the record says: counts, spans, and the cases in which the default is behind."""
    text = (HERE / "leaderboard" / "head.md").read_text(encoding="utf-8").strip()
    known = {"cases": f"{len(record['cases'])}", "size": f"{2 * record['size']:.0f}", "spans": _spans(record)}
    for score in SCORES:
        gaps = {name: gap for name, (gap, _) in _gaps(record, OURS, score).items()}
        known[f"ahead {score}"] = f"{sum(gap < -ALIKE for gap in gaps.values())} of {counted(len(gaps), 'case')}"
        known[f"behind {score}"] = _places([name for name, gap in gaps.items() if gap > ALIKE])
    return re.sub(r"\{([^{}]+)\}", lambda found: known[found[1]], text)


def _places(cases: list[str]) -> str:
    """Parts by vial, as in "boat and gear in air"."""
    found = []
    for vial in VIALS:
        parts = [name.split(", ")[0] for name in cases if name.endswith(f", {vial}")]
        if parts:
            found.append(f"{' and '.join(filter(None, [', '.join(parts[:-1]), parts[-1]]))} {PLACES[vial]}")
    return "; ".join(found) or "nowhere"


def _spans(record: dict[str, Any]) -> str:
    """For each vial, the least and greatest surface error and exposure of the default and of the best other program."""
    rows = [
        "| vial | parts | surface [µm] | best other [µm] | exposure [s] | soonest other [s] |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for vial in VIALS:
        cases = [case for name, case in record["cases"].items() if name.endswith(f", {vial}")]
        cells = []
        for score in ("rms_um", "seconds"):
            found = [_measured(case, DOCUMENTED, score) for case in cases]
            ours = [each[OURS] for each in found if OURS in each]
            others = [min(homes) for each in found if (homes := [each[name] for name in each if ENTRIES[name].home])]
            cells += [
                " to ".join(_cell(score, end(values, default=None)) for end in (min, max)) for values in (ours, others)
            ]
        rows += [f"| {PLACES[vial]} | {len(cases)} | {' | '.join(cells)} |"] if cases else []
    return "\n".join(rows)


def _gaps(record: dict[str, Any], entry: str, score: str) -> dict[str, tuple[float, str]]:
    """For each case, how far an entry of ours is behind the best other program, relatively, and who that is."""
    gaps, sign = {}, SCORES[score][2]
    for name, case in record["cases"].items():
        found = _measured(case, DOCUMENTED, score)
        best = min((each for each in found if ENTRIES[each].home), key=lambda each: sign * found[each], default="")
        if best and entry in found:
            gap = sign * (found[entry] - found[best]) / max(abs(found[entry]), abs(found[best]), 1e-9)
            values = f"{_cell(score, found[best])}, ours {_cell(score, found[entry])}"
            gaps[name] = (gap, f"{name}: {ENTRIES[best].label} {values}")
    return gaps


def _standing(record: dict[str, Any], entry: str) -> str:
    """In how many cases an entry of ours is ahead of every other program, and where it is farthest behind."""
    cases = [name for name, case in record["cases"].items() if entry in _measured(case, DOCUMENTED, "rms_um")]
    rows = [f"| {ENTRIES[entry].label}, {counted(len(cases), 'case')} | ahead | alike | behind | farthest behind |",
            "|---|--:|--:|--:|---|"]  # fmt: skip
    for score, (title, _, _) in SCORES.items():
        gaps = list(_gaps(record, entry, score).values())
        ahead, behind = (sum(side * gap > ALIKE for gap, _ in gaps) for side in (-1, 1))
        text = max(gaps)[1] if behind else ""
        rows.append(f"| {title} | {ahead} | {len(gaps) - ahead - behind} | {behind} | {text} |")
    return "\n".join(rows) if cases else ""


def _measured(case: dict[str, Any], key: str, score: str) -> dict[str, float]:
    values = {name: each.get(key, {}).get(score) for name, each in case["entries"].items()}
    return {name: value for name, value in values.items() if value is not None}


def _cell(score: str, value: float | None) -> str:
    if value is None:
        return "–"
    return format(100.0 * value if score in SHARES else value, SCORES[score][1]).replace("-", "−")


def _table(case: dict[str, Any], key: str, timed: bool = False) -> str:
    """A row for each entry; the best of each column is bold."""
    facts = [score for score in SCORES if _measured(case, key, score)]
    best = {score: min(_measured(case, key, score).values(), key=lambda v: SCORES[score][2] * v) for score in facts}
    title = f"{key} s of processor time" if timed else "entry"
    lines = [f"| {title} | {' | '.join(SCORES[score][0] for score in facts)} |", "|---|" + "--:|" * len(facts)]
    for name in (name for name in ENTRIES if key in case["entries"].get(name, {})):
        each = case["entries"][name][key]
        if "missing" in each:
            lines.append(f"| {ENTRIES[name].label} | no result: {each['missing']} |" + " |" * (len(facts) - 1))
            continue
        cells = [_cell(score, each.get(score)) for score in facts]
        marked = (
            f"**{cell}**" if each.get(score) == best[score] else cell for score, cell in zip(facts, cells, strict=True)
        )
        lines.append(f"| {ENTRIES[name].label} | {' | '.join(marked)} |")
    return "\n".join(lines)


def _picture(docs: Path, name: str, case: dict[str, Any], work: Path) -> str:
    """Draw the slice of each entry with its worst voxel, if one is newer and none is lacking; "" without any."""
    kept = [entry for entry in ENTRIES if entry in case["entries"] and (work / entry / "worst.npz").exists()]
    path = f"compared-{work.name}.png"
    if not kept:
        return path if (docs / path).exists() else ""
    newest = max((work / entry / "worst.npz").stat().st_mtime for entry in kept)
    lacking = set(case["entries"]) - set(kept) - {LIMITED}  # its slice is the default's where the default is as soon
    if (docs / path).exists() and (lacking or (docs / path).stat().st_mtime > newest):
        return path
    wide = min(3, len(kept))
    letters = [[chr(97 + k) if (k := row * wide + at) < len(kept) else "." for at in range(wide)]
               for row in range(-(-len(kept) // wide))]  # fmt: skip
    figure, axes = style.sheet(letters, 3.7 * len(letters))
    for k, entry in enumerate(kept):
        with np.load(work / entry / "worst.npz") as slab:
            dose, depth, (i, j, _), deepest = (slab[each] for each in ("dose", "depth", "place", "deepest"))
        axis = axes[chr(97 + k)]
        title = f"{ENTRIES[entry].label}\nwrong {float(deepest):.1f} pixels from the surface"
        style.shown(axis, dose, title, vmin=0.0, vmax=2.0)
        axis.contour(dose.T, [1.0], colors=style.ORANGE, linewidths=1.2)
        axis.contour(depth.T, [0.0], colors="white", linewidths=0.6)
        axis.plot(i, j, "o", ms=14, mfc="none", mec=style.GREEN, mew=1.5)
    (docs / path).write_bytes(style.png(figure))
    return path
