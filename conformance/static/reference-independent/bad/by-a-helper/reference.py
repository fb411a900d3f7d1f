"""Answers of the model."""

from . import helper  # noqa: F401


def answers(config):
    def answer(episode):
        return []

    return answer
