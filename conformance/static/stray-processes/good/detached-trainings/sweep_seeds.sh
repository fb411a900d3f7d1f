#!/usr/bin/env bash
# One training for each seed, each in a session of its own that outlives this terminal.
set -euo pipefail
for seed in 0 1 2; do
    tmux has-session -t "sweep_${seed}" 2>/dev/null && tmux kill-session -t "sweep_${seed}"
    tmux new-session -d -s "sweep_${seed}" "python train.py --seed ${seed}"
done
mkdir -p logs
date >> logs/started.txt
cat <<'TEXT'
Look at one:  tmux attach -t sweep_0
TEXT
