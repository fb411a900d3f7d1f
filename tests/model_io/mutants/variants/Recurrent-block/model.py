import numpy as np

from xpl import Policy

from .authors.pipeline import Agent


class Model(Policy):
    def load(self, config):
        self.agent = Agent()

    def predict(self, inputs, envs):
        answers = []
        for image, joints, prompt, env in zip(inputs["image"], inputs["joints"], inputs["prompt"], envs):
            memory = self.memory(env)
            hidden = self.agent.begin() if memory.value is None else memory.value
            rows, hidden = self.agent.step(hidden, image, joints, prompt)
            memory.keep(hidden)
            answers.append(rows)
        return np.stack(answers)
