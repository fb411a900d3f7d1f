"""Answers of the model."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import model  # noqa: E402, F401


def answers(config):
    def answer(episode):
        return []

    return answer
