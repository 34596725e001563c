"""The command line: ``vam demo | solve | prove | export | gallery | doctor | devices | bench``; all thin."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 1 an error that was explained, 130 stopped by Ctrl-C."""
    from vamgpu.cli.commands import app
    from vamgpu.errors import Cancelled, VamError

    try:
        return int(app(arguments, result_action="return_value", exit_on_error=True) or 0)
    except (Cancelled, KeyboardInterrupt):
        sys.stderr.write("\nstopped; nothing half-written was left\n")
        return 130
    except VamError as error:
        sys.stderr.write("".join(f"error: {line}\n" for line in str(error).splitlines()))
        return 1
