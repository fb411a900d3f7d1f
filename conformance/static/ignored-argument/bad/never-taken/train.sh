#!/usr/bin/env bash
set -e
export CUDA_VISIBLE_DEVICES=$DEVICES
exec python train.py "$1" "$2" "$3" "$4" "$5"
