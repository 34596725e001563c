"""Documents, help, messages and names use the field's words."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from trees import tree_of

ROOT = Path(__file__).resolve().parent.parent
GENERATED = {"keys.md", "gallery.md"}
"""Pages of docs/ that are written from the code; those of docs/gallery are, too."""

WORDS = {
    r"\bpos(e|es)\b": "angle",
    r"\bprices?\b|\bpriced\b": "dual variable, weight or cost",
    r"\bow(e|es|ed)\b": "pending, or scaled dual",
    r"\bpairs of projections\b": "projector evaluations",
    r"\bbinds\b": "limits",
    r"\btold\b": "reported, notified or controlled by",
    r"\bwanted\b": "expected",
    r"\blegs?\b": "run segment, or straight length",
    r"\bgarbles\b": "is malformed",
    r"\bforsakes?\b|\bforsaken\b": "disconnect",
    r"\brehears(e|es|al|als|ed|ing)\b": "dry run",
    r"\blapses?\b": "depletion substep",
    r"\bbooths?\b|\blaborator(y|ies)\b": "emulated rig",
    r"\bwitness(es)?\b": "dose monitor",
    r"\binsists?\b": "run all",
    r"\bclaimed\b": "predicted by the solver",
    r"\bnameless\b": "unlinked temporary",
    r"\bpictures on mirrors\b|\bpictures/s\b": "frames",
    r"\bno light whatever\b": "no patterns",
    r"\bhead start\b": "initial dose",
    r"\bso many\b": "this number of",
    r"\blook(s|ed|ing)? (at|for)\b": "check, examine or search",
    r"\bsiblings?\b": "versions",
    r"\btaken? up again\b": "resumed",
    r"\bbut for\b": "except",
    r"\b(does|did|do) not do\b": "does not suffice",
}
"""A regular expression → what a reader of the field expects in its place."""

NAMES = {
    r"SplitSteps": "ADMM",
    r"_looked_for": "reflected",
    r"_Saddle": "PDHG",
    r"light_step|limit_step": "primal_step, dual_step",
    r"GrayPrices": "multipliers",
    r"owed|owes|regained": "scaled_dual, multipliers or pending_versions",
    r"Piece": "PartialProblem",
    r"Pace": "StepRule or RateLimit",
    r"against_\w+": "unsupported_reason",
    r"pays_on_rings|are_enough": "prefers_rings, covers",
    r"_bared|_bulge": "unwrap, max_chord_deviation",
    r"Belt": "RingBand",
    r"head_start": "initial_dose",
    r"Delivering": "CalibratedProjection",
    r"Seen": "Reconstruction",
    r"Outlook": "Forecast",
    r"_Room": "a function",
    r"Asked": "BodyRequirement",
    r"Given|Decided": "Start, FixedFrames",
    r"garbles": "is_malformed",
    r"told_by": "controlled_by",
    r"FramePlans": "FrameVersions",
    r"cease|forsake|recall": "cancel, disconnect, restore",
    r"Desk|heard": "PlannerClient, receive",
    r"Doorkeeper": "TokenAuth",
    r"Companion": "PrintObserver",
    r"Chamber": "DoseRecorder",
    r"lean_gain|weigh_evidence": "tilted_gain, likelihood_weights",
    r"Aims|Carried|Aimed|Course": "LossWeights, CoRotatingMedium, Misaligned, Trajectory",
    r"Booth|Bench|Stand|Witness": "an emulated rig's part, DoseMonitor",
    r"Supply|Maker|PlaneStream": "FrameSource, PlanePacker, UploadQueue",
    r"Shown": "FrameRecord",
}
"""A regular expression for whole names → what stands in their place."""

FILES = {
    "kept", "opening", "outer", "dark", "shown", "found", "told", "given", "expected", "claimed", "carried", "measured",
    "watched", "watching", "following", "sourced", "delivering", "spelling", "best", "choose", "saved", "exact",
    "least", "joined", "unjudged", "rising", "graded", "square", "sliced", "pickled", "zipped", "moves", "scaled",
    "sampled", "stationary",
}  # fmt: skip
"""Modules named for a part of speech instead of for what they hold."""


def prose(text: str) -> Iterator[tuple[int, str]]:
    """Number and words of each line of a page, without code, addresses and the front matter."""
    code = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            code = not code
        elif not code:
            yield number, re.sub(r"`[^`]*`|\]\([^)]*\)", " ", line)


def pages() -> list[Path]:
    """Pages that people write."""
    docs = [path for path in (ROOT / "docs").glob("*.md") if path.name not in GENERATED]
    return sorted(
        [
            *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "DECISIONS")),
            *docs,
            *(ROOT / "docs" / "tutorials").glob("*.md"),
        ]
    )


@cache
def modules(*packages: str) -> dict[Path, ast.Module]:
    """Trees of the modules of packages, by their files."""
    if len(packages) > 1:
        return {path: tree for package in packages for path, tree in modules(package).items()}
    files = [path for package in packages for path in sorted((ROOT / package).rglob("*.py"))]
    return {path: tree_of(path.read_text("utf-8")) for path in files if not path.is_symlink()}


def texts(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of the strings under a node, those between the braces of an f-string left out."""
    inside = {id(part) for field in ast.walk(node) if isinstance(field, ast.FormattedValue) for part in ast.walk(field)}
    for part in ast.walk(node):
        if isinstance(part, ast.Constant) and isinstance(part.value, str) and id(part) not in inside:
            yield part.lineno, part.value


def _called(node: ast.Call) -> str:
    """Name of a function or method that is called."""
    return getattr(node.func, "id", getattr(node.func, "attr", ""))


def messages(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """What errors and warnings of a module say."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for argument in (*node.exc.args, *(keyword.value for keyword in node.exc.keywords)):
                yield from texts(argument)
        elif isinstance(node, ast.Call) and _called(node) == "warn" and node.args:
            yield from texts(node.args[0])


@cache
def defined() -> dict[str, list[str]]:
    """Each name that the packages define, and where."""
    places: dict[str, list[str]] = {}
    for place, tree in modules("vamgpu", "hosts", "kernels").items():
        for line, name in names(tree):
            places.setdefault(name, []).append(f"{place.relative_to(ROOT)}:{line}: {name}")
    return places


def names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Names that a module defines: classes, functions, arguments, variables and attributes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


ANY = re.compile("|".join(WORDS), re.IGNORECASE)


def amiss(place: Path, lines: Iterator[tuple[int, str]]) -> list[str]:
    """Where lines use a word that has a better one."""
    return [
        f"{place.relative_to(ROOT)}:{number}: {found[0]!r} → {instead}"
        for number, line in lines
        if ANY.search(line)
        for word, instead in WORDS.items()
        if (found := re.search(word, line, re.IGNORECASE))
    ]


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.relative_to(ROOT).as_posix())
def test_a_page_uses_the_field_s_words(page: Path) -> None:
    assert not (wrong := amiss(page, prose(page.read_text("utf-8")))), "\n".join(wrong)


def test_the_help_of_the_command_line_uses_the_field_s_words() -> None:
    wrong = [line for place, tree in modules("vamgpu/cli").items() for line in amiss(place, texts(tree))]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("package", ["vamgpu", "hosts", "kernels"])
def test_messages_use_the_field_s_words(package: str) -> None:
    wrong = [line for place, tree in modules(package).items() for line in amiss(place, messages(tree))]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("forbidden", NAMES, ids=lambda names: names.replace(r"\w+", "_"))
def test_no_name_is_one_that_was_replaced(forbidden: str) -> None:
    wrong = [line for name, lines in defined().items() if re.fullmatch(forbidden, name) for line in lines]
    assert not wrong, "\n".join([f"{NAMES[forbidden]} in place of", *wrong])


def test_no_module_is_named_for_a_part_of_speech() -> None:
    wrong = [str(path.relative_to(ROOT)) for path in modules("vamgpu", "hosts", "kernels") if path.stem in FILES]
    assert not wrong, "\n".join(wrong)


def test_a_word_is_found_in_prose_and_messages_alone() -> None:
    page = "The pose of `a pose` in [a page](pose.md)\n```\npose\n```\nposes and a purpose"
    assert [line.split(": ", 1)[1] for line in amiss(ROOT / "x.md", prose(page))] == [
        "'pose' → angle",
        "'poses' → angle",
    ]
    tree = ast.parse('def f(price):\n    "a price"\n    raise ValueError(f"{price} prices")\n')
    assert [line for line, _ in messages(tree)] == [3] and len(amiss(ROOT / "x.py", messages(tree))) == 1
    assert list(names(tree)) == [(1, "f"), (1, "price")]
