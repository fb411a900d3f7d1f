#!/usr/bin/env bash
set -e
# seed=$5 in a comment, and a here-document:
usage() {
  cat <<'EOF'
seed=$5
EOF
}
bench_name=$1; task_name=$2; ckpt_name=$3; env_cfg_type=$4; action_type=$5
seed=${6:-0}
gpu=$7
policy_env=${9:-${CONDA_DEFAULT_ENV:-}}
local_seed=$((seed + 5))
bash ./setup_eval_policy_server.sh "$bench_name" "$task_name" "$ckpt_name" "$env_cfg_type" "$action_type" "$seed" "$gpu"
report() {
  local seed=$1
  action_type=$2
  echo "$seed $action_type"
}
