#!/usr/bin/env bash
set -euo pipefail
exec python "$(dirname "$0")/process_data.py" "$@"
