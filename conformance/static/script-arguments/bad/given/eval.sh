#!/usr/bin/env bash
bench_name=$1 task_name=$2 ckpt_name=$3 env_cfg_type=$4 action_type=$5 seed=$6
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
bash "${here}/setup_eval_policy_server.sh" \
  "${bench_name}" "${task_name}" "${ckpt_name}" "${env_cfg_type}" \
  "${seed}" "${action_type}" &
wait
