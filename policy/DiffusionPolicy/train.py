"""Trains with LeRobot's own loss; `xpl train` runs it in the policy's Python. Killed at any moment, it goes on."""

from pathlib import Path

from xpl.training import lerobot

lerobot.train(Path(__file__).parent)
