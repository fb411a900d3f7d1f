"""Turns trajectories into training data."""

import argparse
import logging

logger = logging.getLogger(__name__)


def convert(path, *, fps: int = 30):
    """Convert one trajectory."""
    raise NotImplementedError("TODO")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("path")
    arguments = parser.parse_args()
    logger.info("converting")
    convert(arguments.path)


if __name__ == "__main__":
    main()
