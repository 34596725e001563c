#!/usr/bin/env bash
# Install the programs of profiling/leaderboard, each in an environment of its own. Nothing of them becomes part of vamgpu.
#   leaderboard.sh [DIR]     DIR defaults to .peers; then set VAM_LEADERBOARD=DIR
# VAMToolbox needs Python 3.12 (PYTHON312). LEAP is built for processors. On processors, Dr.TVAM needs libLLVM 17 or later
# (DRJIT_LIBLLVM_PATH), for example of Debian's package libllvm19.
set -euo pipefail
dir=${1:-.peers}
mkdir -p "$dir/src"
dir=$(cd "$dir" && pwd)
common="numpy scipy scikit-image pillow"

environment() { # NAME PYTHON PACKAGES…
  "$2" -m venv "$dir/$1"
  "$dir/$1/bin/python" -m pip install -q $common "${@:3}"
}
source_of() { # NAME URL PATHS…: its Python files are found through a path file
  [ -d "$dir/src/$1" ] || git clone -q "$2" "$dir/src/$1"
  site=$("$dir/$1/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  printf "$dir/src/$1/%s\n" "${@:3}" >"$site/checkout.pth"
}

environment drtvam "${PYTHON:-python3}" drtvam trimesh

environment vamtoolbox "${PYTHON312:-python3.12}" astra-toolbox torch trimesh matplotlib opencv-python-headless dill pyglet \
  PyOpenGL vedo pyvista colorama ffmpeg-python tqdm
source_of vamtoolbox https://github.com/computed-axial-lithography/VAMToolbox .

environment leap "${PYTHON:-python3}" imageio
source_of leap https://github.com/LLNL/LEAP src VAM
# Its sources for processors name two functions for GPUs, which are never called.
(cd "$dir/src/leap/src" && g++ -std=c++17 -O2 -fPIC -shared -fopenmp -D__USE_CPU -D'cudaFree(x)=free(x)' \
  -D'zeroPadForOffsetScan_GPU(...)=nullptr' ./*.cpp -o libleapct.so)
