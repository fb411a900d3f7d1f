set -euo pipefail
for gpu in 0 1; do
    tmux new-session -d -s "server_${gpu}" "CUDA_VISIBLE_DEVICES=${gpu} python serve.py"
done
nohup python watch.py &
python wait_for.py
echo "stop them by: tmux kill-server"
