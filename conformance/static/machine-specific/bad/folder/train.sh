#!/usr/bin/env bash
exec python train.py --data "${DATA_ROOT:-/mnt/disk1/robot/data}"
