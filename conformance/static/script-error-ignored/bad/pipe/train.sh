#!/usr/bin/env bash
set -e
python train.py 2>&1 | tee train.log
