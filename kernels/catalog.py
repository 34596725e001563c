"""Every declared kernel, read from the files beside this one; ``python -m vamgpu.kernels.catalog`` writes README.md."""

from __future__ import annotations

import hashlib
import json
from importlib import import_module
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.kernels.pointwise import opencl, warp
from vamgpu.kernels.signature import Field, Kernel, Moved, Scalar

FOLDER = Path(__file__).resolve().parent
RECORD = FOLDER.parent / "profiling" / "records" / "kernels-h200.json"
"""Errors and times of the kernels on a GPU."""
ERROR = 1e-3
"""Largest error of a kernel that counts as tested there: the share of counts that the contract tests allow."""
TABLE = "| kernel | computes | files | one item | read | written | tested on |"
"""Head of the generated part of README.md, which extends to its end."""


def concepts() -> tuple[str, ...]:
    """Names of the concepts: files with kernels."""
    names = sorted(path.stem for path in FOLDER.glob("[a-z]*.py") if not path.stem.endswith("_warp"))
    return tuple(name for name in names if declared(name))


def kernels() -> tuple[Kernel, ...]:
    """Every kernel of every concept."""
    return tuple(kernel for concept in concepts() for kernel in declared(concept))


def declared(concept: str) -> list[Kernel]:
    """The kernels of a concept."""
    values = vars(import_module(f"vamgpu.kernels.{concept}")).values()
    return [value for value in values if isinstance(value, Kernel) and value.concept == concept]


def bytes_per_item(kernel: Kernel, *, written: bool) -> str:
    """Bytes read or written per element of ``kernel.over``; arrays count once, an axis's name means its length."""
    # Tables that share no axis with ``over``, or only some of its axes, are listed by name.
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


def text_hash(kernel: Kernel) -> str:
    """Hash of a kernel's name, OpenCL and Warp text; records hold it."""
    sibling = FOLDER / f"{kernel.concept}_warp.py"
    text = opencl(kernel) + (warp(kernel) if kernel.pointwise else sibling.read_text(encoding="utf-8"))
    return hashlib.sha256((kernel.name + text).encode()).hexdigest()[:16]


def on_gpu(rows: list[dict[str, Any]]) -> set[str]:
    """Hashes of the texts that agreed with their definitions on every device of a record."""
    return {row.get("text", "") for row in rows} - {row.get("text") for row in rows if not row["error"] <= ERROR}


def readme() -> str:
    """README.md: its introduction as it stands, and the table of all kernels as declared."""
    introduction = (FOLDER / "README.md").read_text(encoding="utf-8").split(TABLE)[0]
    tested = on_gpu(json.loads(RECORD.read_text(encoding="utf-8"))["kernels"])
    rows = [TABLE, "|---" * TABLE.count(" |") + "|"]
    for kernel in kernels():
        computes = (kernel.definition.__doc__ or "").split("\n")[0].replace("|", "\\|")
        endings = (".py",) if kernel.pointwise else (".py", ".cl", "_warp.py")
        files = " ".join(f"[{end}]({kernel.concept}{end})" for end in endings)
        read, written = (bytes_per_item(kernel, written=writes) for writes in (False, True))
        devices = "processors, GPU" if text_hash(kernel) in tested else "processors"
        item = f"{kernel.over}[{', '.join(_axes(kernel.arguments[kernel.over]))}]"
        rows.append(f"| `{kernel.name}` | {computes} | {files} | {item} | {read} | {written} | {devices} |")
    return introduction + "\n".join(rows) + "\n"


if __name__ == "__main__":
    (FOLDER / "README.md").write_text(readme(), encoding="utf-8")
