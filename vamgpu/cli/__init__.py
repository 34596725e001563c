"""The command line: ``vam demo | solve | prove | export | limits | curethrough`` and more."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 1 an error with a message, 130 stopped by Ctrl-C."""
    import vamgpu.cli.calibrate  # noqa: F401 - its commands register themselves
    import vamgpu.cli.exchange  # noqa: F401
    import vamgpu.cli.print  # noqa: F401
    import vamgpu.cli.prove  # noqa: F401
    import vamgpu.cli.rig  # noqa: F401
    import vamgpu.cli.studio  # noqa: F401
    from vamgpu.cli.commands import app
    from vamgpu.errors import Cancelled, OpticsWarning, VamError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("once", OpticsWarning)  # two steps of a job may say the same
            warnings.showwarning = _warn
            return int(app(arguments, result_action="return_value", exit_on_error=True) or 0)
    except (Cancelled, KeyboardInterrupt) as error:
        how = f" {error}" if isinstance(error, KeyboardInterrupt) and error.args else ""
        sys.stderr.write(f"\nStopped.{how}\n")
        return 130
    except BrokenPipeError:  # the reader of the output, such as `head`, has closed it; discard what is buffered
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except VamError as error:
        sys.stderr.write("".join(f"error: {line}\n" for line in str(error).splitlines()))
        return 1
    except MemoryError as error:
        why = str(error) or "the system refused"
        sys.stderr.write(f"error: this machine's memory is used up: {why}; use larger pitches or fewer angles\n")
        return 1


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line, without its place in the code."""
    sys.stderr.write(f"warning: {message}\n")
