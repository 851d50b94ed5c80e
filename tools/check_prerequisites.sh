#!/usr/bin/env bash
# Print in one line the first missing prerequisite and the package that provides it.
python="${1:-python3}"
missing() {
  echo "humanopts: $1; install it with: apt-get install $2" >&2
  exit 2
}
command -v g++ >/dev/null || missing 'there is no g++' g++
command -v git >/dev/null || missing 'there is no git' git
command -v "$python" >/dev/null || missing "there is no $python" 'python3 python3-venv python3-dev'
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  missing "$("$python" --version) is too old, Python 3.11 or newer is needed" python3.11
"$python" -c 'import ensurepip, venv' 2>/dev/null || missing "$python has no venv" python3-venv
"$python" -c 'import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' ||
  missing "the headers of $python are not there" python3-dev
