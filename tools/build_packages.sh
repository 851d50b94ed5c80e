#!/usr/bin/env bash
# build_packages.sh VENV: install the Python packages of src/ into install/, and add their folders
# to the path of a virtual environment, for users' scripts.
set -euo pipefail
venv=$(cd "$1" && pwd)
packages=(humanopts_ros humanopts_env humanopts_learner humanopts_teach)
for package in "${packages[@]}"; do rm -rf "install/$package" "build/$package"; done
export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
PATH="$venv/bin:$PATH" "$venv/bin/colcon" --log-level error build \
  --event-handlers console_direct- summary- --packages-select "${packages[@]}" \
  > build/packages.log 2>&1 || { cat build/packages.log; exit 1; }
printf '%s\n' "$PWD"/install/humanopts_*/lib/python3.*/site-packages > build/humanopts.pth
mv build/humanopts.pth "$(echo "$venv"/lib/python3.*/site-packages)/"
