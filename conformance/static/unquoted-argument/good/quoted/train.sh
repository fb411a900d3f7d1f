#!/usr/bin/env bash
set -e
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
bench_name=$1 seed=$5 extra=${7:-}
bash "${here}/process_data.sh" "${bench_name}" "$2" "$3" "$4" ${extra:+"$extra"}
python "${here}/train.py" --seed ${seed} ${TRAIN_FLAGS:-} task.name=${bench_name} "$@"
echo $1 ${bench_name}
