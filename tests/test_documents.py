"""The documents name what exists."""

from __future__ import annotations

import re
from pathlib import Path

from profiling.gallery import names

ROOT = Path(__file__).resolve().parent.parent
ROWS = {"R": 14, "P": 8, "A": 7, "C": 6}


def test_every_row_of_the_papers_points_to_tests_and_pages_that_exist() -> None:
    text = (ROOT / "docs" / "papers.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([RPAC]\d+) \| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", text, re.M)
    assert [name for name, *_ in rows] == [f"{kind}{k + 1}" for kind, count in ROWS.items() for k in range(count)]
    for name, _, tests, pages in rows:
        files = re.findall(r"\]\(\.\./([^)]+)\)", tests)
        assert files and all((ROOT / file).is_file() for file in files), name
        shown = re.findall(r"\]\(gallery/(\w+)\.md\)", pages)
        assert shown and set(shown) <= set(names()), name


def test_the_readme_is_short() -> None:
    assert (ROOT / "README.md").read_text(encoding="utf-8").count("\n") <= 150


def test_links_of_the_readme_lead_somewhere() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in link]
    assert len(links) >= 4
    assert all((ROOT / link).exists() for link in links), links
