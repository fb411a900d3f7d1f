exec xpl serve "$(dirname "$0")" --set from_script=1 "$@"
