#!/usr/bin/env bash
# Converts trajectories of the standard to the training data of ACT: runs process_data.py in the policy's Python.
set -euo pipefail

if (($# < 4)); then
  cat >&2 <<USAGE
usage: ${0##*/} bench_name ckpt_name env_cfg_type action_type
process_data.sh takes at least 4 arguments, got $#; further ones are passed to xpl.
USAGE
  exit 2
fi

bench_name=$1
ckpt_name=$2
env_cfg_type=$3
action_type=$4

# Print text as a quoted YAML string.
text() { printf "'%s'" "${1//\'/\'\'}"; }

here=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd)

exec "${XPL:-xpl}" prepare "$here" \
  --set "bench_name=$(text "$bench_name")" \
  --set "ckpt_name=$(text "$ckpt_name")" \
  --set "env_cfg_type=$(text "$env_cfg_type")" \
  --set "action_type=$(text "$action_type")" \
  "${@:5}"
