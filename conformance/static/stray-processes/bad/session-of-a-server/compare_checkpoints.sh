#!/usr/bin/env bash
set -euo pipefail
tmux kill-session -t policy 2>/dev/null || true
tmux new-session -d -s policy "python serve.py"
for step in 1000 2000; do
    python client.py --step "${step}"
done
