#!/usr/bin/env bash
policy_server_port=6000
exec python serve.py "$policy_server_port"
