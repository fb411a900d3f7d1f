#!/usr/bin/env bash
source "$(dirname "$0")/strict.sh"
source "$(dirname "$0")/common.sh"
pip install numpy==1.26.4
python convert.py
