#!/bin/sh
# Build an sdist and from it a wheel, and the wheel of the benchmarks; install both into a clean environment, and use them from
# an empty folder.
set -eu
python=$1
root=$(pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m build --quiet --no-isolation --outdir "$work/dist" "$root"
"$python" -m build --quiet --no-isolation --wheel --outdir "$work/dist" "$root/benchmarks"
"$python" -m venv --without-pip "$work/venv"
for wheel in "$work"/dist/fgpose-*.whl "$work"/dist/fgpose_benchmarks-*.whl; do
    hash=$(sha256sum "$wheel" | cut -d " " -f 1)
    "$python" -m pip --python "$work/venv" install --quiet --disable-pip-version-check --only-binary :all: \
        -c "$root/constraints.txt" "file://$wheel#sha256=$hash"
done
cd "$work"
"$work/venv/bin/python" -W error - <<'PYTHON'
import pathlib
import sys

import fgpose
import fgpose_factors

for package in (fgpose, fgpose_factors):
    assert pathlib.Path(package.__file__).is_relative_to(sys.prefix), package.__file__
    assert pathlib.Path(package.__file__).with_name("py.typed").exists(), f"{package.__name__} has no type marker"
assert pathlib.Path(fgpose.__file__).with_name("live").joinpath("page", "page.html").exists(), "the status page is not packed"
for name in fgpose.files.recordings():
    rig, observations = fgpose.files.load_recording(name)
    trajectory = fgpose.smooth(observations.frames(slice(0, 10)), rig)
    assert trajectory.status_share(fgpose.Status.OBSERVED) > 0.9
fgpose.save_trajectory(trajectory, "smoothed.parquet")
assert fgpose.load_trajectory("smoothed.parquet").n_frames == 10
PYTHON
"$work/venv/bin/fgpose" --version
"$work/venv/bin/fgpose" evaluate smoothed.parquet smoothed.parquet > /dev/null
"$work/venv/bin/python" -c "from fgpose_benchmarks.synthetic import embedded_motion as motion; motion('cmu_02_05')"
"$work/venv/bin/fgpose" benchmark --help > /dev/null
echo "wheel and sdist install in a clean environment"
