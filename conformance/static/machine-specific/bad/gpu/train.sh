#!/usr/bin/env bash
set -e
export CUDA_VISIBLE_DEVICES=0
exec python train.py
