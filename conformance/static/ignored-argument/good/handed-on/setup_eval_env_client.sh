#!/usr/bin/env bash
shift 3
exec python client.py "$1"
