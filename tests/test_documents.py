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


def test_the_next_version_has_a_short_changelog() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.findall(r"^## .+?(?=^## |\Z)", text, re.M | re.S)[0]
    assert newest.startswith("## 0.3.0") and newest.count("\n") <= 60
    assert re.findall(r"^### (.+)$", newest, re.M) == ["Added", "Changed", "Removed", "Fixed"]
    bullets = re.findall(r"^- .+$", newest, re.M)
    assert bullets and all(bullet.endswith(".") and ". " not in bullet for bullet in bullets)


def test_every_decision_is_a_short_record_that_the_index_names() -> None:
    text = (ROOT / "DECISIONS.md").read_text(encoding="utf-8")
    index, _, body = text.partition("\n## Records\n")
    records = re.findall(r"^### (\d+)\. ([^\n]+)\n\n(.+?)(?=\n\n###|\Z)", body.rstrip(), re.M | re.S)
    numbers = [int(number) for number in re.findall(r"^### (\d+)", body, re.M)]
    assert [int(number) for number, *_ in records] == numbers == sorted(set(numbers))
    names = {number: f"{number}. {title}" for number, title, _ in records}
    anchors = {number: re.sub(r"[^\w\- ]", "", name.lower()).replace(" ", "-") for number, name in names.items()}
    lines = sorted(re.findall(r"^- \[(\d+)\. (.+)\]\(#(.+)\)$", index, re.M), key=lambda line: int(line[0]))
    assert lines == [(number, title, anchors[number]) for number, title, _ in records]
    for number, title, record in records:
        assert len(f"{title} {record}".split()) <= 150, number
        parts = re.findall(r"^- \*\*(\w+)\*\* (.+)$", record, re.M)
        status = parts[-1][1]
        kinds = ["Status"] if status.startswith("superseded by ") else ["Context", "Decision", "Status"]
        assert [kind for kind, _ in parts] == kinds and record.count("\n") == len(kinds) - 1, number
        named = re.findall(r"\[(\d+)\]\(#([^)]+)\)", status)
        assert status.startswith("accepted") or named, number
        assert all(anchors.get(other) == anchor for other, anchor in named), number
