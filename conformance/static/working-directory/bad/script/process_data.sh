#!/usr/bin/env bash
set -e
python -u convert.py "$1" "$2" "$3" "$4"
