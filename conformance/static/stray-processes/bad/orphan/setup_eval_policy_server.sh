#!/usr/bin/env bash
set -e
PYTHONPATH="$PWD" \
python serve.py --port "$9"
