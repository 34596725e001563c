"""Templates that packages ship, filled in."""

from __future__ import annotations

from importlib import resources
from typing import Any


def template(package: str, name: str) -> str:
    """Text of a file in a package's folder ``templates``."""
    return resources.files(package).joinpath("templates", name).read_text(encoding="utf-8")


def filled(package: str, name: str, **values: Any) -> str:
    """A page made from a template; values are escaped unless the template calls them safe."""
    from jinja2 import Environment

    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(template(package, name)).render(**values)
