#!/usr/bin/env bash
cd vendor || exit 1
pip install -e . || { echo "failed" >&2; exit 1; }
pip install torch==2.4.1
if [ $? -ne 0 ]; then exit 1; fi
exec python -c "import torch"
