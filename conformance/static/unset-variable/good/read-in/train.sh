#!/usr/bin/env bash
set -e
source "$(dirname "$0")/settings.sh"
python train.py "$dataset"
