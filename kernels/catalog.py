"""Every declared kernel, read off the files beside this one; ``python -m vamgpu.kernels.catalog`` prints the table."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from vamgpu.kernels.signature import Field, Kernel, Scalar, Table

FOLDER = Path(__file__).parent


def concepts() -> tuple[str, ...]:
    """Names of the concepts: files with an OpenCL sibling."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.cl")))


def kernels() -> tuple[Kernel, ...]:
    """Every kernel of every concept."""
    found = []
    for concept in concepts():
        module = import_module(f"vamgpu.kernels.{concept}")
        own = (value for value in vars(module).values() if isinstance(value, Kernel) and value.concept == concept)
        found += list(own)
    return tuple(found)


def described(name: str, spec: Field | Table | Scalar) -> str:
    """An argument in a few characters: bold where it is written, ``[axes]`` of a field, ``type[axes]`` of a table."""
    if isinstance(spec, Scalar):
        return f"{name}: {spec.dtype}"
    kind = "" if isinstance(spec, Field) else f": {spec.dtype} "
    text = f"{name}{kind}[{', '.join(spec.axes)}]"
    return f"**{text}**" if spec.writes else text


def markdown() -> str:
    """The table of all kernels, as it stands in README.md."""
    rows = ["| concept | kernel | arguments | definition · OpenCL · Warp |", "|---|---|---|---|"]
    for kernel in kernels():
        concept = kernel.concept
        arguments = "; ".join(described(name, spec) for name, spec in kernel.arguments.items())
        files = " · ".join(f"[{end}]({concept}{end})" for end in (".py", ".cl", "_warp.py"))
        rows.append(f"| {concept} | `{kernel.name}` | {arguments} | {files} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(markdown())
