#!/usr/bin/env bash
set -euo pipefail
bench_name=$1 task_name=$2 ckpt_name=$3 env_cfg_type=$4 action_type=$5 seed=$6 policy_gpu_id=$7 policy_env=$8 port=$9
export CKPT="${ckpt_name}" ROBOT="${env_cfg_type}" ACTION="${action_type}" SEED="${seed}"
conda activate "${policy_env}"
CUDA_VISIBLE_DEVICES="${policy_gpu_id}" python - <<PY
serve(port=${port})
PY
