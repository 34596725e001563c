"""Do the tests bite? One small physical error a cited test, applied to a copy of the tree; what survives is named.

    python tests/mutations.py               every row of docs/papers.md, and the further ones of mutations.toml
    python tests/mutations.py R3 P1 margin  these rows alone
    python tests/mutations.py --all-devices on every device that works here, not on one of each kind

Each mutation runs only the tests that it names, up to the first that fails. Prints a line and the seconds of each.
Exits 1 where a test survives, or where it does not run at all: a test that cannot be collected proves nothing.
The tests must pass without a mutation; ``--sound`` runs the same tests on the copy as it is, and wants all to pass.
"""

from __future__ import annotations

import argparse
import compileall
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from py_compile import PycInvalidationMode

ROOT = Path(__file__).resolve().parent.parent
CODE = ("vamgpu", "kernels", "hosts")
COPIED = (*CODE, "tests", "profiling", "docs", "pyproject.toml", "README.md")
ONE_OF_EACH_KIND = "not pocl and not warp and not GPU"
"""Names of tests to run: those of NumPy and of one OpenCL device, and those that ask for no device."""
PASSED, FAILED = 0, 1
"""Exit codes of pytest; all others say that tests were not run."""
PATIENCE = 900.0
"""Seconds for the tests of one mutation, before they count as hung, and so as dead."""


@dataclass(frozen=True)
class Mutation:
    """One error in one file.

    Args:
        row: of docs/papers.md, or a word for what no row covers.
        error: what is wrong afterwards, in words.
        file: from the root of the repository.
        old: text that occurs exactly once in the file.
        new: what replaces it.
        tests: paths from the root, each with or without ``::test``; every one of them must fail.
        devices: which tests to run where only some devices can notice, as pytest's -k takes it.
    """

    row: str
    error: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    devices: str | None = None


def table() -> tuple[Mutation, ...]:
    """All mutations of mutations.toml, in its order."""
    text = (ROOT / "tests" / "mutations.toml").read_text(encoding="utf-8")
    return tuple(Mutation(**(row | {"tests": tuple(row["tests"])})) for row in tomllib.loads(text)["mutation"])


def copied(place: Path) -> Path:
    """The tree in a new folder, without byte code."""
    unwanted = shutil.ignore_patterns("__pycache__", "*.pyc")
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, place / name, symlinks=True, ignore=unwanted)
        else:
            shutil.copy2(source, place / name)
    return place


def compiled(tree: Path) -> Path:
    """The tree with byte code that its source is checked against, not by time: no mutation may be missed."""
    for name in CODE:
        compileall.compile_dir(tree / name, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return tree


def mutated(mutation: Mutation, text: str) -> str:
    """The text of a file with the error in it. Raises `ValueError` unless it has exactly one place for it."""
    found = text.count(mutation.old)
    if found != 1:
        raise ValueError(f"{mutation.row}: {mutation.file} has {mutation.old!r} {found} times; expected once")
    return text.replace(mutation.old, mutation.new)


def outcome(tree: Path, tests: tuple[str, ...], devices: str) -> int:
    """Exit code of pytest on some tests of a tree, up to the first failure."""
    command = [sys.executable, "-m", "pytest", "-o", "addopts=--import-mode=importlib", "-xq", "-p", "no:cacheprovider"]
    command += tests
    if devices:
        command += ["-k", devices]
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        return subprocess.run(command, cwd=tree, env=environment, capture_output=True, timeout=PATIENCE).returncode
    except subprocess.TimeoutExpired:
        return FAILED


def verdict(code: int, expected: int) -> str:
    """One word for what happened: what was expected, the other, or nothing at all."""
    if code not in (PASSED, FAILED):
        return "BROKEN"
    if code == expected:
        return "died" if expected == FAILED else "sound"
    return "SURVIVED" if expected == FAILED else "FAILS UNMUTATED"


def judged(tree: Path, mutation: Mutation, devices: str, sound: bool) -> str:
    """Apply one mutation to the tree, run its tests one file after the other, and take it back."""
    path = tree / mutation.file
    original = path.read_text(encoding="utf-8")
    changed = mutated(mutation, original)
    expected = PASSED if sound else FAILED
    path.write_text(original if sound else changed, encoding="utf-8")
    try:
        some = devices if mutation.devices is None else mutation.devices
        words = {test: verdict(outcome(tree, (test,), some), expected) for test in mutation.tests}
    finally:
        path.write_text(original, encoding="utf-8")
    bad = [f"{word}: {test}" for test, word in words.items() if word not in ("died", "sound")]
    return "; ".join(bad) or ("sound" if sound else "died")


def main() -> int:
    """Run the rows asked for; 0 if every mutation was noticed by each of its tests."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help="rows to run; all by default")
    parser.add_argument("--all-devices", action="store_true", help="do not restrict tests to one device of each kind")
    parser.add_argument("--sound", action="store_true", help="run the tests without the mutations; all must pass")
    asked, mutations = parser.parse_args(), table()
    known = dict.fromkeys(mutation.row for mutation in mutations)
    if unknown := [row for row in asked.rows if row not in known]:
        parser.error(f"no row {', '.join(unknown)}; there are {', '.join(known)}")
    chosen = [mutation for mutation in mutations if not asked.rows or mutation.row in asked.rows]
    devices, bad = "" if asked.all_devices else ONE_OF_EACH_KIND, 0
    with tempfile.TemporaryDirectory(prefix="mutated-") as place:
        tree = compiled(copied(Path(place).resolve()))
        for mutation in chosen:
            began = time.perf_counter()
            said = judged(tree, mutation, devices, asked.sound)
            bad += said not in ("died", "sound")
            print(f"{mutation.row:8} {time.perf_counter() - began:6.1f} s  {mutation.error}: {said}", flush=True)
    print(f"{len(chosen)} mutations, {bad} not noticed" if not asked.sound else f"{len(chosen)} runs, {bad} not sound")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
