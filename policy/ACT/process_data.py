"""Prepares training: statistics and shapes of demonstrations, in LeRobot's format; `xpl prepare` runs it."""

from pathlib import Path

from xpl.training import lerobot

lerobot.prepare(Path(__file__).parent, "act")
