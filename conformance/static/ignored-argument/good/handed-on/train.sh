#!/usr/bin/env bash
exec python train.py "$@"
