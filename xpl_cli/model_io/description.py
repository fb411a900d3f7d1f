"""Description of a convention: its meaning, its values with their names in libraries, and usual mistakes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl.catalogue import AdapterCase
from xpl.convert import gaps
from xpl.embodiment import embodiment_names, get_embodiment
from xpl_cli.standard import spec
from xpl_cli.standard.vocabulary import VocabularyValue, vocabulary_values

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.catalogue import Convention

_MOST = 12
_SEP = ", "
_PLACE = re.compile(r" \((state|action|image|cam_\w+)\)$")
"""Where a mistake was made."""


@dataclass(frozen=True)
class ConventionDescription:
    """One convention.

    Attributes:
        name: as reference.py and findings call it.
        about: what is to be agreed on.
        known_as: what libraries call it, "library: name" each; "" where none has a name for it.
        keys: the keys of the block that say it, by where they stand.
        values: by key, its values, where there is a list of them.
        mistakes: the usual ones, the likeliest first, each by the value that the model expects.
    """

    name: str
    about: str
    known_as: str
    keys: Mapping[str, Sequence[str]]
    values: Mapping[str, Sequence[VocabularyValue]]
    mistakes: Sequence[str]

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        values = {key: [vars(word) for word in found] for key, found in self.values.items()}
        return {**vars(self), "keys": {group: list(keys) for group, keys in self.keys.items()}, "values": values}


def describe(one: Convention) -> ConventionDescription:
    """Return the description of a convention."""
    definitions = spec.schema("model_io")["$defs"]
    word = next(word for word in vocabulary_values(definitions["convention"], definitions) if word.name == one.name)
    return ConventionDescription(one.name, word.meaning, word.known_as, one.keys, dict(_values(one)), _mistakes(one))


def _values(one: Convention) -> Iterator[tuple[str, Sequence[VocabularyValue]]]:
    """Yield the keys that have a list of values, with it."""
    defs = spec.schema("model_io")["$defs"]
    definition_names = {"images": "image", "vectors": "action", "history": "own_history"}
    for group, keys in one.keys.items():
        entry = defs.get(definition_names.get(group, group), {})
        step_properties = [how for step in defs["step"]["properties"].values() for how in [step.get("properties", {})]]
        for key in entry.get("properties", {}) if "*" in keys else keys:
            schemas = [entry.get("properties", {}), *(step_properties if group == "steps" else ())]
            schema: dict[str, Any] = next((listed[key] for listed in schemas if key in listed), {})
            listed = vocabulary_values(schema, defs)
            if listed:
                yield key, listed


def _mistakes(one: Convention) -> list[str]:
    """Return the mistakes of an adapter whose block is the standard's own, and of one that converts in code."""
    robots = map(get_embodiment, embodiment_names())  # one stands for all
    robot = next(one for one in robots if len(one.arms) == 1 and one.arms[0].joint_names is not None)
    mistakes = []
    for action_type in sdk.ACTION_TYPES:
        vector = {"parts": gaps._parts(robot, action_type)}  # noqa: SLF001 - the standard's own
        image = {"input": "image", "channels": "rgb", "layout": "hwc", "dtype": "float32"}
        block = {
            "images": [{**image, "cameras": [camera]} for camera in robot.cameras[:2]],
            "state": [{"input": "state", **vector}],
            "action": {**vector, "reference": "absolute"},
            "instruction": {"input": "prompt"},
            "history": {"length": 2},
        }
        cameras = robot.cameras[:2]
        case = AdapterCase(robot, action_type, block, cameras=cameras, history=2, instructions=["Do it."])
        mistakes += [*one.config_mistakes(case), *one.io_mistakes(case), *one.input_mistakes(case)]
    descriptions = [
        _PLACE.sub("", mistake.description) for mistake in sorted(mistakes, key=lambda mistake: mistake.rank)
    ]
    return list(dict.fromkeys(descriptions))[:_MOST]


def render_markdown(one: ConventionDescription) -> Iterator[str]:
    """Yield the lines of a convention's description, as Markdown."""
    yield f"# {one.name}"
    yield ""
    known = f" Known as {one.known_as}." if one.known_as else ""
    yield f"{one.about[:1].upper()}{one.about[1:]}.{known}"
    groups_by_keys: dict[str, list[str]] = {}
    for group, keys in one.keys.items():
        key_list = "all keys" if "*" in keys else ", ".join(f"`{key}`" for key in keys)
        groups_by_keys.setdefault(key_list, []).append(group)
    yield ""
    yield f"In the block: {'; '.join(f'{keys} of {_SEP.join(groups)}' for keys, groups in groups_by_keys.items())}."
    for key, listed in one.values.items():
        yield ""
        yield f"Values of `{key}`:"
        yield ""
        yield from (f"- `{word.name}`: {word.description}" for word in listed)
    if one.mistakes:
        yield ""
        yield "Usual mistakes, by what the model means where the adapter does otherwise:"
        yield ""
        yield from (f"- {words}" for words in one.mistakes)
