"""Answers of the model."""

SOURCES = {}
CONVENTIONS = dict(SOURCES)


def answers(config):
    def answer(episode):
        return []

    return answer
