"""The table of mutations does not rot: every cited test stands in it, and the code still has a place for each."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent
if str(FOLDER) not in sys.path:
    sys.path.append(str(FOLDER))

from mutations import COPIED, FAILED, PASSED, Mutation, copied, judged, mutated, table, verdict  # noqa: E402

ROOT = FOLDER.parent
MUTATIONS = table()


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


def test_a_survivor_and_tests_that_do_not_run_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a tree of one function: a test that looks at it dies, one that does not survives."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # sooner done
    (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\n", encoding="utf-8")
    (tmp_path / "twice.py").write_text("def twice(x):\n    return 2 * x\n", encoding="utf-8")
    for name, check in (("sharp", "twice(3) == 6"), ("blunt", "twice(0) == 0")):
        text = f"from twice import twice\n\n\ndef test() -> None:\n    assert {check}\n"
        (tmp_path / f"test_{name}.py").write_text(text, encoding="utf-8")
    mutation = Mutation("X", "thrice", "twice.py", "2 * x", "3 * x", ("test_sharp.py", "test_blunt.py"))
    assert judged(tmp_path, mutation, "", sound=False) == "SURVIVED: test_blunt.py"
    assert (tmp_path / "twice.py").read_text(encoding="utf-8").endswith("2 * x\n")
    assert [verdict(code, FAILED) for code in (PASSED, FAILED, 2, 4, 5)] == ["SURVIVED", "died"] + 3 * ["BROKEN"]
    assert [verdict(code, PASSED) for code in (PASSED, FAILED, 5)] == ["sound", "FAILS UNMUTATED", "BROKEN"]


def test_the_copy_is_whole(tmp_path: Path) -> None:
    tree = copied(tmp_path)
    assert (tree / "vamgpu" / "kernels" / "signature.py").is_file()
    assert (tree / "vamgpu" / "hosts").resolve() == (tree / "hosts").resolve()
