#!/usr/bin/env bash
work="$(cd "$1" && pwd)"
rm -r $work/tmp
