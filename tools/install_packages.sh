#!/usr/bin/env bash
# install_packages.sh VENV LOCK [FOLDER]: install the packages of a lock file into a virtual
# environment or, with the tools of this environment, into a folder. uv is fast; pip is used if uv
# cannot reach the package index, which may be set in pip's configuration. Dependencies are not
# resolved, since the lock file is complete. Nothing is compiled, since few modules are imported.
set -euo pipefail
venv=$1 lock=$2
into=(${3:+--target "$3"})
with_pip() {
  "$venv/bin/pip" install --disable-pip-version-check --quiet --no-compile --no-deps \
    --require-hashes "${into[@]}" -r "$1" 2> >(grep -v -e '^WARNING: Location' -e DEPRECATION >&2)
}
if [ ! -x "$venv/bin/uv" ]; then
  awk '/^uv==/ {found = 1} found {print} found && !/\\$/ {exit}' "$lock" > "$venv/uv.lock"
  with_pip "$venv/uv.lock"
fi
VIRTUAL_ENV=$venv "$venv/bin/uv" pip install --quiet --no-deps --require-hashes \
  "${into[@]}" -r "$lock" 2> "$venv/uv.log" || with_pip "$lock"
