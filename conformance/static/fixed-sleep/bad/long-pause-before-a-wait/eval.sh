#!/usr/bin/env bash
bash ./setup_eval_policy_server.sh "$@" &
sleep 120
bash ../../utils/wait_for_port.sh localhost "${10}" 600
bash ./setup_eval_env_client.sh "$@"
