"""What hosts/README.md tells is so: its rig is one, and each fault has its test."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vamgpu.hosts.rigs import config
from vamgpu.hosts.rigs.config import RigFile, parse_rig
from vamgpu.schema.registry import FAMILIES, find

HERE = Path(__file__).parent
TEXT = (HERE.parents[1] / "hosts" / "README.md").read_text(encoding="utf-8")
ROWS = [line for line in TEXT.partition("## Faults")[2].splitlines() if line.startswith("| ") and ".py" in line]


def test_its_rigs_are_read() -> None:
    web, vial = (parse_rig(block).setup for block in re.findall(r"```toml\n(.*?)```", TEXT, re.S))
    assert web.rig.machine == "web" and web.safety.lease == 0.25 and web.lens is not None
    assert vial.rig.machine == "vial" and vial.camera is not None and vial.light.power == 0.8


@pytest.mark.parametrize("table", [name for name in RigFile.model_fields if name != "lift"])  # with keys of [motion]
def test_each_key_of_a_rig_is_listed(table: str) -> None:
    row = next(line for line in TEXT.splitlines() if line.startswith(f"| `[{table}]` |"))
    kinds = re.findall(r"[\w.]+Section", str(RigFile.model_fields[table].annotation))
    parts = [find(f"rig_{table}", kind) for kind in FAMILIES[f"rig_{table}"].nouns] if not kinds else []
    for part in parts or [getattr(config, kinds[0].rsplit(".", 1)[-1])]:
        assert not [key for key in part.model_fields if f"`{key}`" not in row]
    kinds = [kind for kind in FAMILIES[f"rig_{table}"].nouns if "emulated" not in kind] if parts else []
    assert all(kind in row for kind in kinds)


RIGS = [path.stem for path in (HERE.parents[1] / "docs" / "rigs").glob("*.toml")]


def test_each_rig_has_its_column() -> None:
    (head,) = (line for line in TEXT.splitlines() if line.startswith("| fault | light"))
    columns = [cell.strip() for cell in head.strip("|").split("|")]
    named = ", ".join(columns[3:-1]).split(", ")
    assert sorted(named) == sorted(f"`{name}`" for name in RIGS) and columns[-1] == "test"
    for row in ROWS:
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert len(cells) == len(columns), row
        seen = cells[3:-1]
        assert all(re.fullmatch(r"seen by [a-z ]+|not seen|does not apply", cell) for cell in seen), row
        assert set(seen) != {"does not apply"}, row


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip()[:40])
def test_every_fault_has_its_test(row: str) -> None:
    named = re.findall(r"`((?:firmware/)?test_\w+\.py)(?:::(test_\w+))?`", row)
    assert named and len(ROWS) > 20
    for file, test in named:
        source = (HERE / file).read_text(encoding="utf-8")
        assert not test or f"def {test}(" in source
