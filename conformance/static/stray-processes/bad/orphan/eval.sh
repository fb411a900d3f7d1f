#!/usr/bin/env bash
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
SERVER="${here}/setup_eval_policy_server.sh"
cleanup() { kill "${server_pid}" 2>/dev/null || true; }
trap cleanup EXIT
bash "${SERVER}" "$@" &
server_pid=$!
bash "${here}/setup_eval_env_client.sh" "$@"
