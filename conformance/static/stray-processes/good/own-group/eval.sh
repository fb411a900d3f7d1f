#!/usr/bin/env bash
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
trap 'kill -- "-${server_pid}"' EXIT
setsid bash "${here}/setup_eval_policy_server.sh" "$@" &
server_pid=$!
python client.py
