#!/usr/bin/env bash
set -euo pipefail
ckpt_name=$2
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
python "${here}/train.py" --name "run-${ckpt_nmae}"
