#!/usr/bin/env bash
# Trains DiffusionPolicy: runs train.py in the policy's Python.
set -euo pipefail

if (($# < 6)); then
  cat >&2 <<USAGE
usage: ${0##*/} bench_name ckpt_name env_cfg_type action_type seed gpu_id
train.sh takes at least 6 arguments, got $#; further ones are passed to xpl.
USAGE
  exit 2
fi

bench_name=$1
ckpt_name=$2
env_cfg_type=$3
action_type=$4
seed=$5
gpu_id=$6

# Print text as a quoted YAML string.
text() { printf "'%s'" "${1//\'/\'\'}"; }

here=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd)

exec "${XPL:-xpl}" train "$here" \
  --gpu "$gpu_id" \
  --set "bench_name=$(text "$bench_name")" \
  --set "ckpt_name=$(text "$ckpt_name")" \
  --set "env_cfg_type=$(text "$env_cfg_type")" \
  --set "action_type=$(text "$action_type")" \
  --set "seed=$seed" \
  "${@:7}"
