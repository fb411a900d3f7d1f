#!/usr/bin/env bash
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
ckpt_name=$2
run="${3:-}"
if [[ -z "${run}" ]]; then run=default; fi
rm -rf "${here}/checkpoints/${ckpt_name}" "${here}/runs/${run}" "${here:?}/tmp"
cd "${here}" && rm -rf build
scratch="$(mktemp -d)"
rm -rf "${scratch}"
rm -f "${1}/one-file"
