#!/usr/bin/env bash
set -euo pipefail
tmux new-session -d -s policy "bash setup_eval_policy_server.sh $*"
echo "watch it by: tmux attach -t policy"
bash setup_eval_env_client.sh "$@"
