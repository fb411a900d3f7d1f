#!/usr/bin/env bash
set -e
python -m vendor.serve --port 7001 &
sleep 10
exec python -m XPolicyLab.setup_policy_server --port "$9"
