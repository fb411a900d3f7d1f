#!/usr/bin/env bash
python train.py "$1"
