#!/usr/bin/env bash
set -euo pipefail
bench_name=${1}
echo "weights for ${bench_name} are published: there is nothing to train"
exit 0
