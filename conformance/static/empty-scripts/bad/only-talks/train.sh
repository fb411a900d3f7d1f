#!/usr/bin/env bash
set -euo pipefail

bench_name=$1
mkdir -p checkpoints
echo "TODO: training on $bench_name"
exit 1
