#!/usr/bin/env bash
set -e
exec python "$(dirname "$0")/process_data.py" "$@"
