"""Other words for what an action is counted from, chunks, histories and instructions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from xpl import _spec as sdk
from xpl_cli.model_io.alternatives.block.edits import GONE, Block, Candidate, Change, Site, everywhere, parts, word

TEMPLATES = (
    "{instruction}",
    "{instruction}\n",
    "In: What action should the robot take to {instruction}?\nOut:",
    "Task: {instruction}",
    "Task: {instruction}\n",
    "Task: {instruction}, State: ",
    "task: {instruction}",
    "{instruction}.",
)
"""Prompts that were met."""


def references(block: Block) -> Iterator[Candidate]:
    """Yield other things that commands are counted from, for all parts and for each."""
    whole = [Site(("action",), block["action"])]
    for reference in ("absolute", "delta_state", "cumulative", "delta_command"):
        change = word("reference", reference)
        yield from everywhere(whole, 0, f"reference: {reference}", "action_reference", change)
    sites = [site for site in parts(block, "joints", "hand", "position", "rotation") if site.group == "action"]
    for reference in ("absolute", "delta_state", "cumulative", "delta_command"):
        change = word("reference", reference, block["action"]["reference"])
        told = f"reference of the part: {reference}"
        yield from everywhere(sites, 1, told, "action_reference", change)
    yield from everywhere(sites, 1, "reference of the part: none", "action_reference", _without("reference"))
    history = (block.get("history") or {}).get("length", 1)
    for first in dict.fromkeys((0, 1, history - 1, 2)):
        yield from everywhere(whole, 1, f"first: {first}", "chunk", word("first", first, 0))


def histories(block: Block) -> Iterator[Candidate]:
    """Yield other histories."""
    history = block.get("history")
    if not history:
        return
    site = [Site(("history",), history)]
    length = history["length"]
    for pad in ("zeros", "repeat"):
        yield from everywhere(site, 0, f"history: pad: {pad}", "history_padding", word("pad", pad, "repeat"))
    for order in ("newest_first", "oldest_first"):
        yield from everywhere(
            site, 0, f"history: order: {order}", "history_order", word("order", order, "oldest_first")
        )
    stride = history.get("stride", 1)
    for value in dict.fromkeys((1, stride + 1, max(1, stride - 1), 2, 3, 4, 2 * stride, max(1, stride // 2))):
        yield from everywhere(site, 1, f"history: stride: {value}", "history_stride", word("stride", value, 1))
    for of in (["images", "state"], ["images"], ["state"]):
        told = f"history: of: {', '.join(of)}"
        yield from everywhere(site, 2, told, "history_length", word("of", of, ["images", "state"]))
    for value in dict.fromkeys((1, length - 1, length + 1, 2)):
        if value >= 1:
            yield from everywhere(site, 3, f"history: length: {value}", "history_length", word("length", value))


def instructions(block: Block, templates: Sequence[str] = ()) -> Iterator[Candidate]:
    """Yield other ways to write the instruction; `templates` besides those that are known."""
    how = block.get(sdk.Obs.INSTRUCTION)
    if not how:
        return
    site = [Site((sdk.Obs.INSTRUCTION,), how)]
    for case in ("lower", "keep"):
        yield from everywhere(site, 0, f"instruction: case: {case}", sdk.Obs.INSTRUCTION, word("case", case, "keep"))
    for strip in ("", " ", ".", ". ", " .", " \n", "\n"):
        told = f"instruction: strip: {strip!r}"
        yield from everywhere(site, 0 if strip in ("", " ") else 1, told, sdk.Obs.INSTRUCTION, word("strip", strip, ""))
    template = how.get("template", "{instruction}")
    for text in dict.fromkeys(
        (*templates, *TEMPLATES, template.strip(), f"{template}\n", f"{template} ", template.lower())
    ):
        if "{instruction}" in text:
            told = f"instruction: template: {text!r}"
            yield from everywhere(site, 1, told, sdk.Obs.INSTRUCTION, word("template", text, "{instruction}"))
    for empty in ("blank", "refuse"):
        yield from everywhere(
            site, 3, f"instruction: empty: {empty}", sdk.Obs.INSTRUCTION, word("empty", empty, "refuse")
        )


def _without(key: str) -> Change:
    return lambda entry: {key: GONE} if key in entry else None
