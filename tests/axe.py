"""The audit of a page by axe-core, where npm installed it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).parent.parent / "node_modules" / "axe-core" / "axe.min.js"


def serious(page: Any) -> list[str]:
    """Serious faults of a page; skips the test without axe."""
    if not FILE.is_file():
        pytest.skip("needs npm install --no-save axe-core@4.14.1 in the folder of pyproject.toml")
    page.evaluate(FILE.read_text("utf-8"))  # past the policy of the page, which refuses scripts from elsewhere
    faults = page.evaluate("axe.run(document).then(({ violations }) => violations)")
    return [f"{fault['id']}: {node['html'][:120]} {node['failureSummary']}" for fault in faults
            if fault["impact"] in ("serious", "critical") for node in fault["nodes"]]  # fmt: skip
