"""The public names of hosts: documented with every argument, and reached by their old names for one release."""

from __future__ import annotations

import dataclasses
import inspect
from pathlib import Path

import pytest

from vamgpu.hosts import rig
from vamgpu.hosts.rig import plan, read_rig, rehearsal


@pytest.mark.parametrize("name", rig.__all__)
def test_every_argument_is_documented(name: str) -> None:
    found = getattr(rig, name)
    text = inspect.getdoc(found) or ""
    if dataclasses.is_dataclass(found):
        section, wanted = "Attributes:", [field.name for field in dataclasses.fields(found)]
    else:
        section, wanted = "Args:", list(inspect.signature(found).parameters)
        returns = inspect.signature(found).return_annotation
        assert ("Returns:" in text) is (returns != "None")
    assert section in text and not [each for each in wanted if f"\n    {each}: " not in text.partition(section)[2]]


def test_old_names_work_and_warn(job: Path) -> None:
    planned = plan(job, read_rig("emulated"), turns=1)
    with pytest.warns(DeprecationWarning, match="jobs"):
        assert planned.works is planned.jobs
    emulated = rehearsal(planned)
    with pytest.warns(DeprecationWarning, match="monitor"):
        assert emulated.witness is emulated.monitor
