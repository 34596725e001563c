"""The components of the library and their fields: one definition for Python, job files, manifests and the list of keys.

A component is a class whose constructor takes named fields, typed by unit and bounds; `registry` names it.
"""

from vamgpu.schema.noun import Field, check, fields_of
from vamgpu.schema.registry import register
from vamgpu.schema.write import write

__all__ = ["Field", "check", "fields_of", "register", "write"]
