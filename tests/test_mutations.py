"""The table of mutations does not rot: every cited test stands in it, and the code still has a place for each."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent
if str(FOLDER) not in sys.path:
    sys.path.append(str(FOLDER))

from mutation_rows import MUTATIONS, Mutation  # noqa: E402
from mutations import COPIED, FAILED, PASSED, copied, judged, mutated, verdict  # noqa: E402

ROOT = FOLDER.parent


def cited() -> dict[str, set[str]]:
    """Tests by row of the table of papers."""
    text = (ROOT / "docs" / "papers.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([RPAC]\d+) \| [^|]+ \| ([^|]+) \| [^|]+ \|$", text, re.M)
    return {name: set(re.findall(r"\]\(\.\./([^)]+)\)", tests)) for name, tests in rows}


def test_every_test_that_a_paper_cites_has_a_mutation() -> None:
    rows = cited()
    assert len(rows) == 35
    for row, tests in rows.items():
        broken = {test.split("::")[0] for m in MUTATIONS if m.row == row for test in m.tests}
        assert broken == tests, f"{row}: cited {sorted(tests)}, mutations run {sorted(broken)}"


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: f"{m.row}: {m.error}")
def test_a_mutation_has_its_place_and_its_tests(mutation: Mutation) -> None:
    assert mutation.file.split("/")[0] in COPIED
    text = (ROOT / mutation.file).read_text(encoding="utf-8")
    changed = mutated(mutation, text)
    assert changed != text
    if mutation.file.endswith(".py"):
        compile(changed, mutation.file, "exec")
    assert mutation.tests
    for test in mutation.tests:
        file, _, name = test.partition("::")
        assert (ROOT / file).is_file(), test
        assert not name or f"\ndef {name}(" in (ROOT / file).read_text(encoding="utf-8"), test


def test_a_place_that_is_gone_or_ambiguous_is_told() -> None:
    mutation = Mutation("X", "nothing", "a.py", "1 + 1", "2", ("t.py",))
    assert mutated(mutation, "x = 1 + 1") == "x = 2"
    for text in ("x = 2", "x = 1 + 1 + (1 + 1)"):
        with pytest.raises(ValueError, match="expected once"):
            mutated(mutation, text)


def test_a_survivor_and_tests_that_do_not_run_are_told(tmp_path: Path) -> None:
    """On a tree of one function: a test that checks it dies, one that does not survives, one that is none is broken."""
    (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\n", encoding="utf-8")
    (tmp_path / "twice.py").write_text("def twice(x):\n    return 2 * x\n", encoding="utf-8")
    head = "import sys, pathlib\nsys.path.insert(0, str(pathlib.Path(__file__).parent))\nfrom twice import twice\n"
    (tmp_path / "test_sharp.py").write_text(head + "def test(): assert twice(3) == 6\n", encoding="utf-8")
    (tmp_path / "test_blunt.py").write_text(head + "def test(): assert twice(0) == 0\n", encoding="utf-8")
    mutation = Mutation("X", "thrice", "twice.py", "2 * x", "3 * x", ("test_sharp.py", "test_blunt.py", "test_none.py"))
    said = judged(tmp_path, mutation, "", sound=False)
    assert said == "SURVIVED: test_blunt.py; BROKEN: test_none.py"
    assert (tmp_path / "twice.py").read_text(encoding="utf-8").endswith("2 * x\n")
    assert judged(tmp_path, mutation, "", sound=True) == "BROKEN: test_none.py"
    assert verdict(FAILED, PASSED) == "FAILS UNMUTATED"


def test_the_copy_is_whole(tmp_path: Path) -> None:
    tree = copied(tmp_path)
    assert (tree / "vamgpu" / "kernels" / "signature.py").is_file()
    assert (tree / "vamgpu" / "hosts").resolve() == (tree / "hosts").resolve()
