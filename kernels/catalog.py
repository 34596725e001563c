"""Every declared kernel, read from the files beside this one; ``python -m vamgpu.kernels.catalog`` writes README.md."""

from __future__ import annotations

import json
from importlib import import_module
from math import prod
from pathlib import Path

import numpy as np

from vamgpu.kernels.signature import Field, Kernel, Moved, Scalar

FOLDER = Path(__file__).resolve().parent
RECORD = FOLDER.parent / "profiling" / "records" / "kernels-h200.json"
"""Errors and times of the kernels on a GPU."""
ERROR = 1e-3
"""Largest error of a kernel that counts as tested there: the share of counts that the contract tests allow."""
TABLE = "| kernel | computes | files | one item | read | written | tested on |"
"""Head of the generated part of README.md, which extends to its end."""


def concepts() -> tuple[str, ...]:
    """Names of the concepts: files with an OpenCL version."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.cl")))


def kernels() -> tuple[Kernel, ...]:
    """Every kernel of every concept."""
    found = []
    for concept in concepts():
        module = import_module(f"vamgpu.kernels.{concept}")
        own = (value for value in vars(module).values() if isinstance(value, Kernel) and value.concept == concept)
        found += list(own)
    return tuple(found)


def bytes_per_item(kernel: Kernel, *, written: bool) -> str:
    """Bytes read or written per element of ``kernel.over``; arrays count once, an axis's name means its length.

    Tables that share no axis with ``over``, or only some of its axes, are listed by name.
    """
    items = _axes(kernel.arguments[kernel.over])
    terms: dict[str, int] = {}
    tables: list[str] = []
    for name, spec in kernel.arguments.items():
        if isinstance(spec, Scalar) or not (spec.writes if written else spec.reads):
            continue
        axes = _axes(spec)
        above, below = [a for a in axes if a not in items], [a for a in items if a not in axes]
        if not isinstance(spec, Field) and (below == items or below and not above):
            tables.append(f"*{name}*")
            continue
        size = np.dtype(spec.dtype).itemsize * prod(int(axis) for axis in spec.axes if axis.isdigit())
        factor = "".join(f"·{axis}" for axis in above)
        if below:
            factor += f"/({'·'.join(below)})" if len(below) > 1 else f"/{below[0]}"
        terms[factor] = terms.get(factor, 0) + size
    return " + ".join([f"{size}{factor}" for factor, size in terms.items()] + tables) or "0"


def _axes(spec: Moved | Scalar) -> list[str]:
    return [axis for axis in getattr(spec, "axes", ()) if not axis.isdigit()]


def on_gpu() -> set[str]:
    """Names of the kernels that agreed with their definitions on every device of the record."""
    rows = json.loads(RECORD.read_text(encoding="utf-8"))["kernels"]
    return {row["kernel"] for row in rows} - {row["kernel"] for row in rows if not row["error"] <= ERROR}


def readme() -> str:
    """README.md: its introduction as it stands, and the table of all kernels as declared."""
    introduction = (FOLDER / "README.md").read_text(encoding="utf-8").split(TABLE)[0]
    tested, rows = on_gpu(), [TABLE, "|---" * TABLE.count(" |") + "|"]
    for kernel in kernels():
        computes = (kernel.definition.__doc__ or "").split("\n")[0].replace("|", "\\|")
        files = " ".join(f"[{end}]({kernel.concept}{end})" for end in (".py", ".cl", "_warp.py"))
        read, written = (bytes_per_item(kernel, written=writes) for writes in (False, True))
        devices = "processors, GPU" if kernel.name in tested else "processors"
        item = f"{kernel.over}[{', '.join(_axes(kernel.arguments[kernel.over]))}]"
        rows.append(f"| `{kernel.name}` | {computes} | {files} | {item} | {read} | {written} | {devices} |")
    return introduction + "\n".join(rows) + "\n"


if __name__ == "__main__":
    (FOLDER / "README.md").write_text(readme(), encoding="utf-8")
