#!/usr/bin/env bash
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
run="${2:-}"
rm -rf "${here}/checkpoints/${run}"
python train.py
