#!/usr/bin/env bash
# step.sh TEXT COMMAND...: run one step of the set-up; print its name before and its time after it,
# on two lines, since another step may run at the same time.
text=$1
shift
begun=$(date +%s.%N)
echo "$text ..."
if said=$("$@" 2>&1); then
  seconds=$(awk -v begun="$begun" -v now="$(date +%s.%N)" 'BEGIN {printf "%.1f", now - begun}')
  echo "$text: $seconds s${said:+ ($said)}"
else
  status=$?
  printf '%s: failed:\n%s\n' "$text" "$said" >&2
  exit $status
fi
