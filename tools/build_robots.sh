#!/usr/bin/env bash
# build_robots.sh VENV: install the simulated robots of examples/ into build/robots.
set -euo pipefail
venv=$(cd "$1" && pwd)
packages=(examples/humanopts_rover examples/humanopts_gripper)
export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
for package in "${packages[@]}"; do rm -rf "build/robots/${package#*/}" "build/${package#*/}"; done
PATH="$venv/bin:$PATH" "$venv/bin/colcon" --log-level error build \
  --event-handlers console_direct- summary- --base-paths "${packages[@]}" \
  --install-base build/robots > build/robots.log 2>&1 || { cat build/robots.log; exit 1; }
