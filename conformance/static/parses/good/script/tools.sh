#!/usr/bin/env bash
# What looks broken, and is not: it's all closed.
case ${1:-"don't"} in
  (if | done) echo "a ) that ends a pattern" ;;
  *) echo "${2:-fine}" $'it\'s' ;;
esac
read -r -d '' text <<'USAGE' || true
this "is not closed, and if nobody cares
USAGE
names=(
  one # isn't two
  "two)"
)
for ((number = 0; number < ${#names[@]}; number++)); do echo "$((number << 1)) $(echo ")" # a ) too
)"; done
if [[ $text =~ ^(a|b\)) ]] && ! grep -q fi <(echo fi); then echo done fi; fi
