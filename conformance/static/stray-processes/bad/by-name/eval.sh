#!/usr/bin/env bash
set -e
pkill -f setup_policy_server.py
python client.py
