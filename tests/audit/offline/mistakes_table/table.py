"""Makes results.json, docs/mistakes.md and its picture of what `trained.py` wrote.

python -m tests.audit.offline.mistakes_table.table [FIRST [AFTER]]
python -m tests.audit.offline.mistakes_table.table --again OUT

FIRST is the OUT of the search as it was when the mistakes were planted, AFTER that of the improved one. Without any,
the page is made of results.json as it is; with --again, what OUT says of contract, parity and success goes into it
first, and of demonstrations as of the improved search: of another training of these policies, for example.
"""

from __future__ import annotations

import argparse
import functools
import json
from collections.abc import Set as AbstractSet
from html import escape
from pathlib import Path
from typing import Any

from tests.audit.offline.mistakes_table.planting import HERE, RIGHT, ROOT, Subject, said, trained
from xpl_cli.audit.rules.registry import find

RESULTS = HERE / "results.json"
PAGE = ROOT / "docs" / "mistakes.md"
PICTURE = ROOT / "docs" / "assets" / "mistakes.svg"
BEGIN, END = "<!-- results -->", "<!-- end of results -->"
_KEPT = {
    "demonstrations": ("outcome", "words", "convention", "share", "right"),
    "parity": ("outcome", "words", "convention"),
    "contract": ("codes",),
    "success": ("successes", "episodes"),
}
Row = dict[str, Any]


def collected(first: Path, after: Path | None) -> list[Row]:
    """Return a row for each mistake, of the rows that proofs wrote."""
    rows_found, alike = [], _alike(first)
    for policy in trained():
        for subject in policy.subjects:
            told = {
                (name, proof): said(folder / "rows" / f"{subject.key}-{proof}.json")
                for name, folder in (("first", first), ("after", after))
                for proof in ("demonstrations", "parity", "contract", "success")
                if folder is not None
            }
            one, other = told["first", "demonstrations"], told.get(("after", "demonstrations"), {})
            any_of = other or one
            if not any_of:
                continue
            same = alike.get(subject.same, {})
            contract = told["first", "contract"] or same.get("contract", {})
            row: Row = {
                "policy": policy.name,
                "sample": subject.sample,
                "mistake": subject.name,
                "conventions": list(any_of["conventions"]),
                "apart": round(any_of["apart"], 4),
                "own": round(any_of["own"], 4),
            }
            for name, whole in (("first", one), ("after", other)):
                row[name] = _kept("demonstrations", whole)
            row["contract"] = _kept("contract", contract)
            parity = told["first", "parity"] or same.get("parity", {})
            row["parity"] = _kept("parity", parity.get("parity") or {})
            row["success"] = _kept("success", told["first", "success"] or same.get("success", {}))
            rows_found.append(row)
    return rows_found


def _alike(first: Path) -> dict[str, dict[str, Row]]:
    """Return what was found of equal adapters: both lists hold some mistakes."""
    ties: dict[str, dict[str, Row]] = {}
    for policy in trained():
        for subject in policy.subjects:
            for proof in ("contract", "parity", "success"):
                if row := said(first / "rows" / f"{subject.key}-{proof}.json"):
                    ties.setdefault(subject.same, {})[proof] = row
    return ties


def again(rows: list[Row], out: Path) -> list[Row]:
    """Return rows with what a run found, where it found something."""
    told, rows_found = _alike(out), []
    for row in rows:
        subject = _subject(row)
        new = dict(row)
        for proof, whole in told.get(subject.same, {}).items():
            new[proof] = _kept(proof, (whole.get("parity") or {}) if proof == "parity" else whole)
        if one := said(out / "rows" / f"{subject.key}-demonstrations.json"):
            new.update(after=_kept("demonstrations", one), apart=round(one["apart"], 4), own=round(one["own"], 4))
        rows_found.append(new)
    return rows_found


def _kept(proof: str, whole: Row) -> Row | None:
    return {key: whole.get(key) for key in _KEPT[proof]} if whole else None


def is_told(row: Row) -> bool:
    """Whether the mistake changes commands by more than the policy is off by itself."""
    return bool(row["apart"] > row["own"])


def named(row: Row, when: str) -> bool | None:
    """Whether demonstrations name a mistake right, None where that was not run; what was right stays so."""
    one, other = row["first"], row["after"]
    if when == "first":
        return None if one is None else bool(one["right"])
    return bool((other or one)["right"])


def rates(rows: list[Row], sample: str, when: str) -> dict[str, tuple[int, int]]:
    """Return of all mistakes, and of those that can be told, how many are named right and how many there are."""
    chosen = [row for row in rows if row["sample"] == sample and row["mistake"] != RIGHT]
    chosen = [row for row in chosen if named(row, when) is not None]
    told = [row for row in chosen if is_told(row)]
    return {
        "all": (sum(named(row, when) or False for row in chosen), len(chosen)),
        "told": (sum(named(row, when) or False for row in told), len(told)),
    }


def results() -> list[Row]:
    """Return the rows of results.json."""
    rows_found: list[Row] = json.loads(RESULTS.read_text())
    return rows_found


# -- the page ----------------------------------------------------------------------------------------------------------


def tables(rows: list[Row]) -> str:
    """Return the tables of the page."""
    large = "without small ones"
    lines = _heads("demonstrations name, of the mistakes", "first search", large, "second search", large)
    independent = "of the independent author"
    for words, chosen, sample in (
        (independent, rows, "out"),
        (f"{independent}, in the block `model_io`", [row for row in rows if not _is_in_code(row)], "out"),
        (f"{independent}, in code", [row for row in rows if _is_in_code(row)], "out"),
        ("of the author of the search", rows, "in"),
    ):
        first, after = rates(chosen, sample, "first"), rates(chosen, sample, "after")
        cells = [_rate(first["all"]), _rate(first["told"]), _rate(after["all"]), _rate(after["told"])]
        lines.append(f"| {words} | {' | '.join(cells)} |")
    right = [row for row in rows if row["mistake"] == RIGHT]
    flagged = [row for row in right if (row["after"] or row["first"])["words"]]
    lines += [
        "",
        f"Correct adapters flagged as wrong: {len(flagged)} of {len(right)}, too few for a rate.",
        "",
        *_counts(rows),
        "",
        *_legend(rows),
        "",
    ]
    for policy in _policies(rows):
        lines += [f"### {policy}", ""]
        mine = [row for row in rows if row["policy"] == policy]
        known = _known(mine)
        lines += _heads("mistake", "contract", "parity", "demonstrations", "success")
        lines += [_line(row, set()) for row in mine if row["mistake"] == RIGHT]
        wrong = sorted((row for row in mine if row["mistake"] != RIGHT), key=lambda row: row["sample"] == "in")
        lines += [_line(row, known) for row in wrong]
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


@functools.cache
def _subjects() -> dict[tuple[str, str, str], Subject]:
    return {(policy.name, one.sample, one.name): one for policy in trained() for one in policy.subjects}


def _subject(row: Row) -> Subject:
    return _subjects()[row["policy"], row["sample"], row["mistake"]]


def _is_in_code(row: Row) -> bool:
    mistake = _subject(row).mistake
    return mistake is not None and mistake.replace is not None


def distinct(rows: list[Row]) -> list[Row]:
    """Return rows of different adapters: of what is in both lists, that of the independent author."""
    distinct_rows: dict[str, Row] = {}
    for row in sorted(rows, key=lambda row: row["sample"] == "in"):
        distinct_rows.setdefault(_subject(row).same, row)
    return list(distinct_rows.values())


def _policies(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(row["policy"] for row in rows))


def _known(rows: list[Row]) -> set[str]:
    """Return the codes that the contract says of the right adapter, too."""
    told = [row["contract"]["codes"] for row in rows if row["mistake"] == RIGHT and row["contract"]]
    return {code for codes in told for code in codes}


def _counts(rows: list[Row]) -> list[str]:
    """Return a table of how many mistakes each proof tells, for each policy: of those that it was asked about."""
    heads = ("contract fails or warns", "parity detects", "parity names", "demonstrations name", "no success")
    lines, sums = _heads("of different adapters", *heads), [(0, 0)] * len(heads)
    different = distinct(rows)
    for policy in _policies(rows):
        mine = [row for row in different if row["policy"] == policy]
        wrong, known = [row for row in mine if row["mistake"] != RIGHT], _known(mine)
        asked = [row for row in wrong if row["parity"] and row["parity"]["outcome"] in ("pass", "fail")]
        tried = [row for row in wrong if row["contract"]]
        played = [row for row in wrong if row["success"]]
        cells = [
            (sum(not known.issuperset(row["contract"]["codes"]) for row in tried), len(tried)),
            (sum(row["parity"]["outcome"] == "fail" for row in asked), len(asked)),
            (sum(_is_named_by_parity(row) for row in asked), len(asked)),
            (sum(bool(named(row, "after")) for row in wrong), len(wrong)),
            (sum(row["success"]["successes"] == 0 for row in played), len(played)),
        ]
        sums = [(one + more, all_ + more_) for (one, all_), (more, more_) in zip(sums, cells, strict=True)]
        lines.append(_counted(policy, cells))
    return [*lines, _counted("**all**", sums)]


def _heads(*names: str) -> list[str]:
    return [f"| {' | '.join(names)} |", f"|{' --- |' * len(names)}"]


def _counted(name: str, cells: list[tuple[int, int]]) -> str:
    return f"| {name} | {' | '.join(f'{one} of {all_}' if all_ else 'not run' for one, all_ in cells)} |"


def _legend(rows: list[Row]) -> list[str]:
    """Return what the codes of the contract mean."""
    codes = sorted({code for row in rows if row["contract"] for code in row["contract"]["codes"]})
    rules = [find(code) for code in codes]
    return [f"- [{one.code}](rules/{one.gate}.md#{one.code.lower()}-{one.slug}): {one.summary}" for one in rules]


def _is_named_by_parity(row: Row) -> bool:
    return bool(row["parity"]["convention"] in row["conventions"])


def _rate(told: tuple[int, int]) -> str:
    return f"{told[0]} of {told[1]} ({told[0] / told[1]:.0%})" if told[1] else "not run"


def _line(row: Row, known: AbstractSet[str]) -> str:
    name = f"**{RIGHT}**" if row["mistake"] == RIGHT else row["mistake"]
    name += " *" if row["mistake"] != RIGHT and row["sample"] == "in" else ""
    return f"| {name} | {_contract(row, known)} | {_parity(row)} | {_demonstrations(row)} | {_success(row)} |"


def _contract(row: Row, known: AbstractSet[str]) -> str:
    """Return what the contract says beyond what it says of the right adapter."""
    told = row["contract"]
    if told is None:
        return ""
    return ", ".join(code for code in told["codes"] if code not in known) or "nothing"


def _parity(row: Row) -> str:
    told = row["parity"]
    if told is None:
        return ""
    if told["outcome"] == "pass":
        return "equal"
    if _is_named_by_parity(row):
        return f"`{_quoted(told['words'])}`"
    return "detected, not named" if told["outcome"] == "fail" else "refused"


def _demonstrations(row: Row) -> str:
    told = row["after"] or row["first"]
    if row["mistake"] == RIGHT:
        return f"flagged: `{_quoted(told['words'])}`" if told["words"] else "fits"
    if told["right"]:
        later = " (second search)" if row["first"] is not None and not row["first"]["right"] else ""
        return f"`{_quoted(told['words'])}`{later}"
    what = f"misnamed: `{_quoted(told['words'])}`" if told["words"] else "missed"
    return f"{what} (small)" if not is_told(row) else what


def _success(row: Row) -> str:
    told = row["success"]
    return "" if told is None else f"{told['successes']} of {told['episodes']}"


def _quoted(words: str) -> str:
    short = words if len(words) < 60 else f"{words[:57]}..."
    return short.replace("|", "/").replace("\n", " ")


def page(rows: list[Row], text: str) -> str:
    """Return the page with its tables made anew."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{tables(rows)}\n{END}{after}"


# -- the picture -------------------------------------------------------------------------------------------------------

_COLOURS = {"contract": "#b4541a", "parity": "#2b6cb0", "demonstrations": "#2f855a", "none": "#a0aec0"}
_WIDTH, _BAR, _LEFT = 720, 15, 290


def picture(rows: list[Row]) -> str:
    """Return a bar for each mistake of the independent author in Tiny_VLA: its success, and which proofs name it."""
    shown = [row for row in rows if row["policy"].startswith("Tiny_VLA") and row["success"]]
    shown = [row for row in shown if row["mistake"] == RIGHT or row["sample"] == "out"]
    height = _BAR * len(shown) + 50
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" font-size="11">',
        "<style>text { font-family: sans-serif }</style>",
        "<title>Success of Tiny_VLA with each mistake of the independent author, and the proofs that find it</title>",
        f'<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>',
    ]
    for place, (proof, colour) in enumerate(_COLOURS.items()):
        x = 20 + 175 * place
        words = {"none": "no proof names it", "contract": "contract finds something"}.get(proof, f"{proof} name it")
        parts.append(f'<rect x="{x}" y="10" width="11" height="11" fill="{colour}"/>')
        parts.append(f'<text x="{x + 16}" y="20">{words.replace("parity name", "parity names")}</text>')
    for number, row in enumerate(shown):
        y = 40 + number * _BAR
        share = row["success"]["successes"] / row["success"]["episodes"]
        parts.append(f'<text x="{_LEFT - 50}" y="{y + 9}" text-anchor="end">{escape(row["mistake"])}</text>')
        for place, proof in enumerate(_provers(row)):
            x = _LEFT - 44 + 12 * place
            parts.append(f'<rect x="{x}" y="{y}" width="10" height="10" fill="{_COLOURS[proof]}"/>')
        width = (_WIDTH - _LEFT - 60) * share
        parts.append(f'<rect x="{_LEFT}" y="{y}" width="{width:.0f}" height="10" fill="#4a5568"/>')
        parts.append(f'<text x="{_LEFT + width + 5:.0f}" y="{y + 9}">{_success(row)}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _provers(row: Row) -> list[str]:
    if row["mistake"] == RIGHT:
        return []
    provers = ["contract"] if row["contract"] and row["contract"]["codes"] else []
    provers += ["parity"] if row["parity"] and _is_named_by_parity(row) else []
    provers += ["demonstrations"] if named(row, "after") else []
    return provers or ["none"]


def main() -> None:
    """Collect the rows, if there are some, and write page and picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("first", type=Path, nargs="?")
    parser.add_argument("after", type=Path, nargs="?")
    parser.add_argument("--again", type=Path, metavar="OUT")
    asked = parser.parse_args()
    rows = results() if asked.first is None else collected(asked.first, asked.after)
    if asked.again is not None:
        rows = again(rows, asked.again)
    RESULTS.write_text("[\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]\n")
    PAGE.write_text(page(rows, PAGE.read_text()))
    PICTURE.write_text(picture(rows))


if __name__ == "__main__":
    main()
