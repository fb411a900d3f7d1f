#!/usr/bin/env bash
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
bash "${here}/setup_eval_policy_server.sh" "$@" &
server_pid=$!
trap 'kill "${server_pid}"' EXIT
bash "${here}/setup_eval_env_client.sh" "$@"
