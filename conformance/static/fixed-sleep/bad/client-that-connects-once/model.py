import socket
import time


class Model:
    def __init__(self, config):
        self.socket = socket.create_connection(("localhost", config["backend_port"]))

    def get_action(self):
        for _ in range(3):
            time.sleep(0.01)
        return self.socket.recv(1)
