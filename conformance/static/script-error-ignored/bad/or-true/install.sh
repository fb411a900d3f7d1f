#!/usr/bin/env bash
set -euo pipefail
pip install flash-attn==2.8.3 || true
