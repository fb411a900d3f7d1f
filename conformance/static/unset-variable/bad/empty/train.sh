#!/usr/bin/env bash
cd "$DATA_ROOT"
python train.py
