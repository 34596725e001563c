"""The public names of hosts are documented with every argument."""

from __future__ import annotations

import dataclasses
import inspect

import pytest

from vamgpu.hosts import rig


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
