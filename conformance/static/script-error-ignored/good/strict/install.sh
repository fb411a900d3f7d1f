#!/bin/bash -e
set -o pipefail
pip install torch==2.4.1 | tee install.log
if ! pip install flash-attn==2.8.3; then
  echo "flash-attn is optional: going on without it"
fi
conda deactivate || true
