#!/usr/bin/env bash
# step.sh TEXT COMMAND...: runs one step of the set-up, and says what it is and how long it took.
text=$1
shift
begun=$(date +%s.%N)
printf '%s ... ' "$text"
if said=$("$@" 2>&1); then
  awk -v begun="$begun" -v now="$(date +%s.%N)" 'BEGIN {printf "%.1f s", now - begun}'
  echo "${said:+ ($said)}"
else
  status=$?
  printf 'failed:\n%s\n' "$said" >&2
  exit $status
fi
