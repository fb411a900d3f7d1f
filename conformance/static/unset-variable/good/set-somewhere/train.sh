#!/usr/bin/env bash

set -euo pipefail
read -r first second <<< "$1 $2"
for gpu in 0 1; do echo "$gpu $first $second"; done
for ((step = 0; step < 3; step++)); do echo "$step"; done
while IFS='=' read -r key value; do echo "$key $value"; done < "$3"
mapfile -t rows < "$3"
printf -v stamp '%(%s)T' -1
report() { local text=$1; echo "$text $stamp ${#rows[@]}"; }
report "$HOME ${USER:-nobody}"
if [[ -n "${EXTRA:-}" ]]; then python train.py "$EXTRA"; fi
names=(a b)
echo "${names[@]}" "$(awk '{print $missing}' "$3")" '$also_missing' \$escaped
: "${WORKERS:=4}"
export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}"
python train.py --workers "$WORKERS"
cat <<'EOF'
$not_expanded
EOF
