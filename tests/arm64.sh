#!/usr/bin/env bash
# Run the races of same_bits.py on an emulated ARM64 processor and compare them with the stored hashes.
# Usage: tests/arm64.sh FOLDER. Needs Debian 12 as root, the network, and ten minutes the first time.
# PyBullet has no wheel for ARM64, so its race is left out.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=$(mkdir -p "$1" && cd "$1" && pwd)
site=$folder/site system=$folder/system

if [ ! -e "$site" ]; then
    dpkg --add-architecture arm64
    apt-get update -qq
    apt-get install -y -qq qemu-user-static
    packages=(python3.11-minimal libpython3.11-minimal libpython3.11-stdlib libc6 libstdc++6 libgcc-s1
        libgomp1 libssl3 zlib1g libexpat1 libffi8 libbz2-1.0 liblzma5 libsqlite3-0 libuuid1 libcrypt1)
    mkdir -p "$folder/packages" "$system"
    (cd "$folder/packages" && apt-get download -qq "${packages[@]/%/:arm64}")
    for package in "$folder"/packages/*.deb; do dpkg -x "$package" "$system"; done
    wanted='^(numpy|numba|llvmlite|scipy|pydantic|pydantic_core|annotated-types|typing_extensions|typing-inspection|gymnasium|cloudpickle|Farama-Notifications|opencv-python-headless|PyYAML|safetensors)=='
    platforms=("--platform=any")
    for version in 2_28 2_27 2_26 2_17; do platforms+=("--platform=manylinux_${version}_aarch64"); done
    .venv/bin/pip freeze | grep -iE "$wanted" > "$folder/wanted.txt"
    .venv/bin/pip install --quiet --no-deps --only-binary=:all: --python-version 3.11 "${platforms[@]}" \
        --target "$site.new" --requirement "$folder/wanted.txt"
    mv "$site.new" "$site"
fi
# Copied over the last one, where the machine code of the emulated processor is kept.
mkdir -p "$folder/checkout"
git ls-files -z league tracks tests garage | xargs -0 cp --parents -t "$folder/checkout"
(
    cd "$folder/checkout"
    export QEMU_LD_PREFIX=$system PYTHONPATH=$folder/checkout:$site OMP_NUM_THREADS=1
    qemu-aarch64-static "$system/usr/bin/python3.11" tests/same_bits.py > "$folder/found.json"
)
.venv/bin/python - "$folder/found.json" <<'END'
import json
import sys

from tests.test_same_bits import RECORDED

found = json.loads(open(sys.argv[1]).read())
for name, seen in found["races"].items():
    print(f"{name:16} {seen} {'as recorded' if seen == RECORDED[name] else 'DIFFERS'}")
print("compiled for", *found["target"])
sys.exit(any(seen != RECORDED[name] for name, seen in found["races"].items()))
END
