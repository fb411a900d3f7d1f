#!/usr/bin/env bash
pip install torch==2.4.1
cd vendor && pip install -e .
cd ../..
pip install -e .
