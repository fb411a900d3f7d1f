"""Prepares a training: statistics and shapes of demonstrations, as LeRobot keeps them; `xpl prepare` runs it."""

from pathlib import Path

from xpl.training import lerobot

lerobot.prepare(Path(__file__).parent, "act")
