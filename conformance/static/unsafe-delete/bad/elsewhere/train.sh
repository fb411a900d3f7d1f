#!/usr/bin/env bash
cd "$(dirname "$0")/cache"
rm -rf tmp
