#!/usr/bin/env bash
set -e
exec env PYTHONUNBUFFERED=1 \
  python serve.py --port "$9"
