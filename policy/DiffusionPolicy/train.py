"""Trains with LeRobot's own loss; `xpl train` runs it in the policy's Python, and resumes it after interruption."""

from pathlib import Path

from xpl.training import lerobot

lerobot.train(Path(__file__).parent)
