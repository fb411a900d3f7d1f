#!/usr/bin/env bash
set -e
python -m pip install --no-deps git+https://git.example.org/team/project.git
