#!/usr/bin/env bash
bash ./setup_eval_policy_server.sh "$@" &
sleep 60
bash ./setup_eval_env_client.sh "$@"
