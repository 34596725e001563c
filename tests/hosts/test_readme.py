"""What hosts/README.md tells is so: its rig is one, and each fault has its test."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vamgpu.hosts.rigs.config import parse_rig

HERE = Path(__file__).parent
TEXT = (HERE.parents[1] / "hosts" / "README.md").read_text(encoding="utf-8")
ROWS = [line for line in TEXT.partition("## Faults")[2].splitlines() if line.startswith("| ") and ".py" in line]


def test_its_rig_is_read() -> None:
    block = re.search(r"```toml\n(.*?)```", TEXT, re.S)
    assert block is not None
    wanted = parse_rig(block[1]).wanted
    assert wanted.rig.machine == "web" and wanted.safety.lease == 0.25 and wanted.lens is not None


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip()[:40])
def test_every_fault_has_its_test(row: str) -> None:
    named = re.findall(r"`((?:firmware/)?test_\w+\.py)(?:::(test_\w+))?`", row)
    assert named and len(ROWS) > 20
    for file, test in named:
        source = (HERE / file).read_text(encoding="utf-8")
        assert not test or f"def {test}(" in source
