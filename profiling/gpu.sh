#!/usr/bin/env bash
# Everything that is measured on a machine with a GPU, in one go of less than eight minutes.
#   DEVICES="warp:cuda:0" and SIZES="256 512" choose other devices and sizes; TAIL=lines of each log that are shown.
#   OUT=folder MESH=benchy.stl LABEL=name bash profiling/gpu.sh [step ...]     steps: tests kernels projectors drtvam main
#   and, when they are named: rings live bits robust gyroids whole, and scaling: the same work on 1, 2, 4, … GPUs, at
#   SCALING="512x360 1024x720", WHOLE=2048x1440x40, WEB=600 (mm), JOBS=10 of JOB=304x360x40. On processors:
#   DEVICES=opencl:pocl:0 COUNTS="1 2" SCALING=48x96 WHOLE=32x48x2 WEB=6 WEB_PITCH=600 JOBS=2 JOB=32x48x2
# Wants vamgpu's dependencies on PYTHONPATH (and pytest for the tests); ASTRA and torch beside them are timed where they
# are there. Logs and records end up in OUT/all.tar.gz, written anew after every step; one that fails or takes too long
# does not stop the next.
set -u
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export PYTHONPATH="${PYTHONPATH:+$PYTHONPATH:}$PWD" PYTHONUNBUFFERED=1
python=${PYTHON:-python3}
export VAM_PEERS_PYTHON=${VAM_PEERS_PYTHON:-$python}
out=${OUT:-out}
mesh=${MESH:-../shared/data/benchy.stl}
label=${LABEL:-gpu}
mkdir -p "$out"
parts=$(mktemp -d)
trap 'rm -rf "$parts"' EXIT
steps=${*:-tests kernels projectors drtvam main}

# step NAME SECONDS COMMAND...: run it if it was asked for; the log comes whole, its end is shown
step() {
    local name=$1 limit=$2 start=$SECONDS
    shift 2
    case " $steps " in *" ${name%%-*} "*) ;; *) return ;; esac
    timeout "$limit" "$@" >"$parts/$name.log" 2>&1
    echo "== $name: exit $?, $((SECONDS - start)) s"
    tail -n "${TAIL:-25}" "$parts/$name.log"
    tar -C "$parts" -czf "$out/all.tar.gz" .
}

gpus=${DEVICES:-$("$python" - <<'PY'
import vamgpu
names = [name for name in vamgpu.devices() if name != "numpy"]
gpu = [n for n in names if "cuda" in n or getattr(vamgpu.open_device(n), "is_gpu", False)]
print(" ".join(gpu))
PY
)}
echo "GPUs: ${gpus:-none}"
[ -n "$gpus" ] || exit 1

for n in ${SIZES:-256 512}; do
    step "projectors-$n" 80 "$python" profiling/projectors.py --n "$n" --devices $gpus --records "$parts" --label "$label"
done
step drtvam 90 "$python" profiling/jobs.py --job drtvam --device $gpus --mesh "$mesh" --records "$parts" --label "$label"
step main 60 "$python" profiling/jobs.py --job main --device $gpus --mesh "$mesh" --records "$parts" --label "$label"
for device in $gpus; do  # twice: the first one compiles
    for time in first later; do
        step "whole-$time-${device//:/-}" 120 "$python" -c "from vamgpu.cli import main; raise SystemExit(main())" bench --job profiling/whole.toml --record \
            "$parts/whole-$time-${device//:/-}-$label.json" --set "solve.device=\"$device\"" --set "target.mesh=\"$(realpath "$mesh")\""
    done
done
[ -f profiling/kernels.py ] && step kernels 40 "$python" profiling/kernels.py
step tests 120 "$python" -m pytest -q -p no:cacheprovider tests -k "cuda or nvidia"
for device in $gpus; do
    name=${device//:/-}
    for n in ${SIZES:-256 512}; do
        step "rings-$n-$name" 60 "$python" profiling/rings.py --n "$n" --device "$device" --records "$parts" --label "$label"
    done
    step "live-$name" 120 "$python" profiling/live.py --sizes 128 256 --angles 360 --evaluations 12 --device "$device" \
        --records "$parts" --label "$label-$name"
    step "bits-$name" 90 "$python" profiling/bits.py --angles 360 --device "$device" --records "$parts" --label "$label-$name"
    step "robust-$name" 60 "$python" profiling/robust.py --mesh "$mesh" --only robust --device "$device" \
        --iterations 400 --records "$parts" --label "$label-$name"
    step "gyroids-$name" 120 "$python" profiling/gyroids.py --slices 2 --iterations 800 --device "$device" \
        --records "$parts" --label "$label-$name"
done
kind=${gpus%% *}
scaling() {
    local name=$1
    shift
    step "scaling-$name" 580 "$python" profiling/scaling.py --kind "${kind%:*}" ${COUNTS:+--counts $COUNTS} "$@" \
        --records "$parts" --label "$label-$name"
}
for size in ${SCALING:-512x360 1024x720}; do
    scaling "$size" --sizes "$size"
done
scaling whole --whole "${WHOLE:-2048x1440x40}"
scaling web --web "${WEB:-600}" ${WEB_PITCH:+--web-pitch "$WEB_PITCH"}
scaling jobs --jobs "${JOBS:-10}" ${JOB:+--job "$JOB"}
