from .base import Base


class Table(Base):
    def take_action(self, action):
        self.steps += 1


def make(config) -> Table:
    environment = Table(config)
    return environment
