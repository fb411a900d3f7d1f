#!/usr/bin/env bash
set -euo pipefail
pip uninstall -y opencv-python || true
bash stop_servers.sh || true
python -c "import flash_attn" || true
pip install numpy==1.26.4
