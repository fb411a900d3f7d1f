#!/usr/bin/env bash
set -e
tmux new-session -d -s server "python server.py"
python client.py
