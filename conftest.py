"""Test workers side by side take one thread each for linear algebra, unless the environment says otherwise."""

import os

if "PYTEST_XDIST_WORKER" in os.environ:  # before NumPy is loaded, which reads them once
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
