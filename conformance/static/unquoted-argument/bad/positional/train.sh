#!/usr/bin/env bash
set -e
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
bench_name=$1 ckpt_name=$2 env_cfg_type=$3 action_type=$4
bash "${here}/process_data.sh" ${bench_name} ${ckpt_name} ${env_cfg_type} ${action_type}
