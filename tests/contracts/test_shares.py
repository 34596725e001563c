"""Which of the devices that stand for others meets a case of a contract."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest


def test_the_device_of_a_case_depends_on_the_case_alone(request: pytest.FixtureRequest) -> None:
    """The others meet it with -m slow: nothing is taken away."""
    shares: Any = request.config.pluginmanager.get_plugin(str(Path(__file__).parents[1] / "conftest.py"))
    second = [name for name in shares.device_list() if shares._is_second(name)]

    def collected(cases: range) -> tuple[int, set[str]]:
        items = list[Any]()
        for name in ("numpy", "warp:cpu", *second):
            for case in cases:
                item: Any = pytest.Function.from_parent(request.node.parent, name="test_a", callobj=lambda: None)
                item.callspec = SimpleNamespace(params={"device": name}, id=f"{name}-{case}")
                items.append(item)
        shares.pytest_collection_modifyitems(items)
        return len(items), {item.callspec.id for item in items if not item.get_closest_marker("slow")}

    (count, every), (_, last) = collected(range(20)), collected(range(3, 20))
    assert count == 20 * (2 + len(second))
    assert last == {name for name in every if int(name.rsplit("-")[-1]) >= 3}
    assert len(every) == 20 * (1 + len(second)) and {"numpy", "warp:cpu"} <= {name.rsplit("-", 1)[0] for name in every}
