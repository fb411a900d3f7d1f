#!/usr/bin/env bash
set -e
export PYTHONPATH=/opt/vendor:$PYTHONPATH
python train.py
