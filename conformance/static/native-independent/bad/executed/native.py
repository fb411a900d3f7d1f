"""Answers of the model."""

from pathlib import Path

HERE = Path(__file__).resolve().parent
exec((HERE / "model.py").read_text())


def answers(config):
    def answer(episode):
        return []

    return answer
