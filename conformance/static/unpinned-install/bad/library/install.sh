#!/usr/bin/env bash
set -e
pip install torch==2.4.1 torchvision numpy pyyaml
