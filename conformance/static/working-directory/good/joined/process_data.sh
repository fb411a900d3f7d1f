#!/usr/bin/env bash
set -e
cd "$(dirname "${BASH_SOURCE[0]}")"
python convert.py "$1" "$2" "$3" "$4"
