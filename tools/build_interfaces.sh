#!/usr/bin/env bash
# build_interfaces.sh VENV PACKAGE INTO: build a package of interfaces, such as
# src/humanopts_interfaces, into a folder such as install/ with the ROS of a virtual environment.
# Only the C type support is built, since Python loads no other. The user's cache folder keeps the
# result for other clones, by a key of these files, this Python and the ROS packages.
set -euo pipefail
venv=$(cd "$1" && pwd)
package=$2
root=$PWD
name=$(basename "$package")
built=$3/$name

key=$({
  find "$package" tools/{build_interfaces.sh,wheels.cmake,generate_interfaces.py} \
    -type f -not -name '*.md' -not -name '*.rst' -print0 |
    LC_ALL=C sort -z | xargs -0 sha256sum
  grep -E '^(ros-|numpy)' requirements-build.lock
  "$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_config_var("SOABI"))'
  ldd --version 2>&1 | sed -n 1p  # reads to the end, so that ldd is not cut off
} | sha256sum | cut -c1-20)
cache=${XDG_CACHE_HOME:-${HOME:-/nonexistent}/.cache}/humanopts/$name-$key

# Copy a tree, and replace the old path in its text files with the new one.
copy() {
  local folder part
  folder=$(dirname "$2")
  mkdir -p "$folder" && part=$(mktemp -d "$folder/.part-XXXXXX") || return
  (cd "$1" && tar cf - --exclude=__pycache__ .) | tar xf - -C "$part" &&
    { grep -rlIF "$3" "$part" || true; } | xargs -r sed -i "s|$3|$4|g" &&
    rm -rf "$2" && mv "$part" "$2" || { rm -rf "$part"; return 1; }
}

mkdir -p "$3" build
touch "$3/COLCON_IGNORE" build/COLCON_IGNORE
if [ -d "$cache" ]; then
  copy "$cache" "$built" @ROOT@ "$root"
  "$venv/bin/python" -m compileall -q "$built"
  echo "from $cache"
  exit
fi
rm -rf "$built"  # it may contain deleted messages
light='-O1 -DNDEBUG'  # builds a tenth faster than -O3; messages are converted as quickly
export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv MAKEFLAGS=-j$(nproc)
PATH="$venv/bin:$PATH" "$venv/bin/colcon" --log-level error build \
  --event-handlers console_direct- summary- --base-paths "$package" --install-base "$3" --cmake-args \
  -DPython3_EXECUTABLE="$venv/bin/python" -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release \
  -DCMAKE_C_FLAGS_RELEASE="$light" -DCMAKE_CXX_FLAGS_RELEASE="$light" \
  -DCMAKE_PROJECT_INCLUDE="$root/tools/wheels.cmake" \
  > "build/$name.log" 2>&1 || { cat "build/$name.log"; exit 1; }
copy "$built" "$cache" "$root" @ROOT@ || echo "$cache cannot be written"
