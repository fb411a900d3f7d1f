#!/usr/bin/env bash
out=$1
rm -rf "${out}/checkpoints"
python train.py
