"""The live page of a print, and its interface for programs, with access control. Needs the extra ``panel``."""

from vamgpu.hosts.panel.server import Panel

__all__ = ["Panel"]
