#!/usr/bin/env bash
set -e
python serve.py --port "$9"
