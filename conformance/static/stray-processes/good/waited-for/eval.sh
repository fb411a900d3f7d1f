#!/usr/bin/env bash
set -e
python client.py &> client.log &
python other.py > other.log 2>&1 &
wait
pkill -P $$ || true
