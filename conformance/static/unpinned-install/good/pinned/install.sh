#!/usr/bin/env bash
set -e
pip install torch==2.4.1 torchvision "numpy<2" pyyaml opencv-python
uv pip install -r requirements.txt --index-url https://index.example.org/numpy
pip install "project @ git+https://git.example.org/team/project.git@0123abc" -e .
pip install --no-build-isolation flash-attn==2.8.3
pip install --upgrade flash-attn
conda install -y numpy
