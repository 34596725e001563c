#!/usr/bin/env bash
# Make a virtual environment with the libraries that vamgpu is timed against. Never part of vamgpu's own environment.
#   install.sh [DIR]                      DIR defaults to .peers
#   VAMTOOLBOX=/path/to/checkout install.sh   also links a checkout of VAMToolbox, which no registry of pip's carries
set -euo pipefail
dir=${1:-.peers}
python=${PYTHON:-python3}
"$python" -m venv "$dir"
"$dir/bin/python" -m pip install -q --upgrade pip
"$dir/bin/python" -m pip install -q numpy scipy scikit-image trimesh rtree torch astra-toolbox numba
if [ -n "${VAMTOOLBOX:-}" ]; then
  # A path file rather than a package install: its own setup pins nothing and must not pull anything in.
  site=$("$dir/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  "$dir/bin/python" -m pip install -q matplotlib
  (cd "$VAMTOOLBOX" && pwd) >"$site/vamtoolbox_checkout.pth"
fi
"$dir/bin/python" - <<'PY'
import importlib
for name in ("torch", "numba", "scipy", "skimage", "astra", "trimesh", "vamtoolbox"):
    try:
        print(f"{name:12} {getattr(importlib.import_module(name), '__version__', 'present')}")
    except Exception as error:
        print(f"{name:12} missing: {type(error).__name__}: {error}")
PY
