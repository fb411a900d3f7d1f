import subprocess
import sys

raise SystemExit(subprocess.call([sys.executable, "-m", "lerobot.scripts.train"]))
