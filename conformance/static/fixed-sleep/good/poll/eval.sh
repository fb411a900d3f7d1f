#!/usr/bin/env bash
bash ./setup_eval_policy_server.sh "$@" &
until curl -s localhost:"${10}" >/dev/null 2>&1; do
  if (( SECONDS > 600 )); then exit 1; fi
  sleep 5
done
for try in 1 2 3; do bash ./setup_eval_env_client.sh "$@" && break || sleep "$((try * 10))"; done
echo "do not sleep 60"
sleep 0.2
kill "$server"
sleep 3
kill -9 "$server"
