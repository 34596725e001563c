"""The live page of a print, and the same for programs, for those who may see it. Needs the extra ``panel``."""

from vamgpu.hosts.panel.auth import loopback
from vamgpu.hosts.panel.server import Panel

__all__ = ["Panel", "loopback"]
