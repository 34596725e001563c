"""The documentation site: ``python -m sphinx -W docs site``."""

from __future__ import annotations

import os
import pkgutil
import re
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import vamgpu  # noqa: E402 - found beside this folder
from vamgpu.jobs.keys import reference  # noqa: E402

project, author, release = "vamgpu", "The vamgpu developers", vamgpu.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "rigs"]
html_theme = "furo"
html_title = f"vamgpu {release}"
html_static_path: list[str] = []
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = os.environ.get("VAMGPU_DOCS_RUN", "force")
"""``off`` draws the tutorials without their results."""
nb_execution_excludepatterns = [] if find_spec("torch") else ["tutorials/own-loss-torch.md"]
drawn_only = nb_execution_mode == "off" or nb_execution_excludepatterns
suppress_warnings = ["myst-nb.lexer"] if drawn_only else []  # a kernel names its language when it runs
nb_execution_timeout = 300
nb_execution_raise_on_error = True
autodoc_typehints = "none"  # units and shapes stand in the docstrings
autodoc_member_order = "bysource"
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True


def public() -> dict[str, list[tuple[str, str]]]:
    """Package → name and the module to take it from, each object once."""
    seen: set[int] = set()
    found: dict[str, list[tuple[str, str]]] = {}
    packages = (info.name for info in pkgutil.walk_packages(vamgpu.__path__, "vamgpu.") if info.ispkg)
    for package in ("vamgpu", *packages):
        for name in getattr(import_module(package), "__all__", ()):
            value = getattr(import_module(package), name)
            if id(value) not in seen and callable(value) and getattr(value, "__module__", "").startswith("vamgpu"):
                seen.add(id(value))
                found.setdefault(package, []).append((name, "class" if isinstance(value, type) else "function"))
    return found


def write_reference(folder: Path) -> None:
    """One page a package, with the docstrings of what it lists as public.

    Args:
        folder: Takes the pages; those that are there and no longer wanted go.
    """
    folder.mkdir(exist_ok=True)
    pages = {f"{package}.md": page(package, names) for package, names in public().items()}
    for old in folder.glob("*.md"):
        if old.name not in pages:
            old.unlink()
    for name, text in pages.items():
        place = folder / name
        if not place.exists() or place.read_text("utf-8") != text:  # an unchanged page is not built anew
            place.write_text(text, "utf-8")


def page(package: str, names: list[tuple[str, str]]) -> str:
    """The page of one package in MyST, its names in alphabetical order."""
    entries = "\n\n".join(
        f".. auto{kind}:: {package}.{name}" + ("\n   :members:" if kind == "class" else "")
        for name, kind in sorted(names, key=lambda entry: entry[0].lower())
    )
    return f"# {package}\n\n```{{eval-rst}}\n{entries}\n```\n"


def plain_bars(app: Any, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:  # noqa: ARG001
    """Let |x| be a magnitude in docstrings, which reStructuredText reads as a substitution."""
    for k, line in enumerate(lines):
        parts = re.split(r"(`+.*?`+)", line)
        parts[::2] = [part.replace("|", "\\|") for part in parts[::2]]
        lines[k] = "".join(parts)


def linked(app: Any, page: str, source: list[str]) -> None:  # noqa: ARG001
    """Give what stands outside this folder as a file; two sentences to each picture of the gallery, and its page."""
    if "/" not in page:
        source[0] = source[0].replace("](../", "](path:../")
    if page == "gallery":
        told = re.sub(
            r"(?m)^\[!\[.*\]\((gallery/\w+\.md)\)$", lambda m: f"{m[0]}\n\n{two_sentences(HERE / m[1])}", source[0]
        )
        source[0] = told + "\n```{toctree}\n:hidden:\n:glob:\ngallery/*\n```\n"


def two_sentences(page: Path) -> str:
    """The first two sentences under the picture of a page."""
    under = page.read_text("utf-8").split("\n\n")[2].replace("\n", " ")
    return " ".join(re.split(r"(?<=[.!?]) ", under)[:2])


def setup(app: Any) -> None:
    """Sphinx calls this once, before it reads any page."""
    write_reference(HERE / "api")
    (HERE / "keys.md").write_text(reference(), "utf-8")
    app.connect("autodoc-process-docstring", plain_bars, priority=400)
    app.connect("source-read", linked)
