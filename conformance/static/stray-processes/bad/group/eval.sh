#!/usr/bin/env bash
set -e
(
  cd vendor
  python server.py
) &
python client.py
