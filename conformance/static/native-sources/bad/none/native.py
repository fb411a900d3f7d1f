"""Answers of the model."""

def answers(config):
    def answer(episode):
        return []

    return answer
