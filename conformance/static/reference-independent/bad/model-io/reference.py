"""Answers of the model."""

import os

import yaml

with open(os.path.join(os.path.dirname(__file__), "policy.yml")) as stream:
    MODEL_IO = yaml.safe_load(stream)["model_io"]


def answers(config):
    def answer(episode):
        return []

    return answer
