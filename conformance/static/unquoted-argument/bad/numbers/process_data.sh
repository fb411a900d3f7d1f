#!/usr/bin/env bash
python3 "$(dirname "$0")/process_data.py" $1 $2 "$3" "$4"
