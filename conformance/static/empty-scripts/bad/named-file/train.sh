#!/usr/bin/env bash
set -euo pipefail

bench_name=$1 ckpt_name=$2 env_cfg_type=$3 action_type=$4 seed=$5 gpu_id=$6
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
cd "$here"
CUDA_VISIBLE_DEVICES=$gpu_id python -u "${here}/learn.py" "$bench_name" "$ckpt_name" "$env_cfg_type" "$action_type" "$seed"
