"""Syntax trees of modules, each made once: several tests read all of the library."""

from __future__ import annotations

import ast
from functools import cache

tree_of = cache(ast.parse)
"""The tree of a text, which nobody may change."""
