"""The code does not grow: lines of packages, of the largest file and of the largest function, in pyproject.toml."""

from __future__ import annotations

import ast
import subprocess
import tomllib
from pathlib import Path

import pytest
from needs import missing
from trees import tree_of

ROOT = Path(__file__).resolve().parent.parent
CEILINGS: dict[str, int] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["vamgpu"]["ceilings"]
PACKAGES = {"vamgpu": (".py",), "hosts": (".py",), "kernels": (".py", ".cl", ".h")}
"""A folder → the endings of its code."""


def tracked(package: str) -> dict[Path, str]:
    """Files of code of a package that git knows, and their text."""
    listed = subprocess.run(["git", "ls-files", "-z", package], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        missing("ceilings count the files that git tracks: run the tests in a clone")
    files = [ROOT / name for name in listed.stdout.split("\0") if Path(name).suffix in PACKAGES[package]]
    return {file: file.read_text("utf-8") for file in files if file.is_file()}


def lines(text: str) -> int:
    return len(text.splitlines())


def longest(text: str) -> tuple[int, str]:
    """Lines of the longest function of a module without its docstring, and its name."""
    found = [(0, "")]
    for node in ast.walk(tree_of(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            said = lines(ast.get_docstring(node, clean=False) or "")
            found.append(((node.end_lineno or node.lineno) - node.lineno + 1 - said, node.name))
    return max(found)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_stays_below_its_ceiling(package: str) -> None:
    total = sum(map(lines, tracked(package).values()))
    assert 0 < total <= CEILINGS[package], f"{package} has {total} lines; expected {CEILINGS[package]} at most"


def test_the_largest_file_stays_below_its_ceiling() -> None:
    most, file = max((lines(text), file) for package in PACKAGES for file, text in tracked(package).items())
    assert most <= CEILINGS["file"], f"{file.relative_to(ROOT)} has {most} lines; expected {CEILINGS['file']} at most"


def test_the_largest_function_stays_below_its_ceiling() -> None:
    most, name, file = max(
        (*longest(text), file)
        for package in PACKAGES
        for file, text in tracked(package).items()
        if file.suffix == ".py"
    )
    assert most <= CEILINGS["function"], f"{file.relative_to(ROOT)}: {name} has {most} lines; see pyproject.toml"


def test_a_function_counts_without_its_docstring() -> None:
    assert longest('def f():\n    """One.\n\n    Two.\n    """\n    a = 1\n    return a\n') == (3, "f")
