#!/usr/bin/env bash
set -e
export CUDA_VISIBLE_DEVICES="${6}"
export MASTER_PORT="${MASTER_PORT:-29500}"
export CUDA_HOME="${CUDA_HOME:-/usr/local/cuda}"
echo "put the data into /mnt/data or so"
exec python train.py --transport 2000 --out "${OUT:?}/data/run" --support 1234 </dev/null
