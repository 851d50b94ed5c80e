#!/usr/bin/env bash
# install_packages.sh VENV LOCK [FOLDER]: installs what a lock file names, into a virtual
# environment, or by its tools into a folder. uv is quick; where it does not reach the package
# index, which pip's own configuration may name, pip does it. A lock file names everything that is
# needed, so nothing else is looked for. Nothing is compiled: little of it is imported.
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
