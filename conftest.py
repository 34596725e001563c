"""Test workers take one thread each for linear algebra, keep byte code, and write to memory where there is enough."""

import gc
import os
import shutil
import sys

if "PYTEST_XDIST_WORKER" in os.environ:
    gc.disable()  # until tests are collected, a quarter of the time of which it takes
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before NumPy is loaded, which reads them once
        os.environ.setdefault(name, "1")
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # JAX takes 75 % of a GPU's memory otherwise
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # for the commands that tests start
    sys.dont_write_bytecode = False
elif os.access(memory := "/dev/shm", os.W_OK) and shutil.disk_usage(memory).free > 8e9:  # a disk takes 3 ms a file
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", memory)
