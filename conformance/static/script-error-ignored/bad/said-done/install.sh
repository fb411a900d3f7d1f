#!/usr/bin/env bash
pip install torch==2.4.1
echo "installed"
