"""Contacts for gym-aloha's own reward: the same numbers and names as of its physics, read once a step."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple


class _Contact(NamedTuple):
    geom1: int
    geom2: int


class ContactTable:
    """The parts of a physics that gym-aloha's `get_reward` reads: contacts and names of geoms.

    The reward reads the list of contacts twice for each contact, and the list is made anew each time; names are looked
    up in each step, and never change.

    Attributes:
        data: itself.
        model: itself.
        ncon: number of contacts.
        contact: the contacts, with the numbers of their two geoms.

    Args:
        physics: dm_control's.
    """

    def __init__(self, physics: Any) -> None:
        self._physics = physics
        self.data = self.model = self
        self.id2name = functools.cache(physics.model.id2name)
        self.look()

    def look(self) -> None:
        """Read the present contacts."""
        self.contact = list(map(_Contact._make, self._physics.data.contact.geom.tolist()))
        self.ncon = len(self.contact)
