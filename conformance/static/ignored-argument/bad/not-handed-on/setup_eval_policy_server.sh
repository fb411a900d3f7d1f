#!/usr/bin/env bash
set -euo pipefail
bench_name=$1 task_name=$2 ckpt_name=$3 env_cfg_type=$4 action_type=$5 seed=$6 policy_gpu_id=$7 policy_env=$8 port=$9
echo "task ${task_name}, seed ${seed}"
if [[ -z "${seed}" ]]; then exit 1; fi
conda activate "${policy_env}"
export CUDA_VISIBLE_DEVICES="${policy_gpu_id}"
exec python serve.py --port "${port}" --overrides ckpt_name="${ckpt_name}" env_cfg_type="${env_cfg_type}" action_type="${action_type}"
