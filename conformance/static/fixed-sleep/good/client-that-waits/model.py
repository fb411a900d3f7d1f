import time

import numpy as np
from link import Link


class Model:
    def __init__(self, config):
        self.link = Link(config["backend_port"])

    def get_action(self):
        return self.link.ask()
