#!/usr/bin/env bash
set -e
cd "$(dirname "$0")"
screen -dmS training bash -c "python train.py 2>&1 | tee train.log"
echo "the log is train.log"
