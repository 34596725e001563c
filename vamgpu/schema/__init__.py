"""The nouns of the library by their fields: one definition for Python, job files, manifests and the list of keys.

A noun is a class whose constructor takes named fields; their types tell the unit and the bounds, its docstring what
they mean. `registry` names the nouns. Nothing here loads more than is asked for.
"""

from __future__ import annotations

from vamgpu.schema.noun import Field, check, fields_of
from vamgpu.schema.registry import register
from vamgpu.schema.write import write

__all__ = ["Field", "check", "fields_of", "register", "write"]
