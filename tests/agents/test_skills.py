"""Skills: the bundles themselves, and how they get to coding agents and stay what they are."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import xpl
from tests.support.checkout import ROOT
from xpl_cli.agents.skills import bundle as bundles
from xpl_cli.agents.skills import installation, instructions, specification
from xpl_cli.basics.errors import UserError
from xpl_cli.main import app

NAMES = [
    "xpl-audit-policy",
    "xpl-debug-policy",
    "xpl-evaluate-policy",
    "xpl-integrate-environment",
    "xpl-integrate-policy",
]

each_skill = pytest.mark.parametrize("skill", bundles.bundles(), ids=lambda skill: skill.name)


class Answer:
    """What a command printed and how it ended."""

    def __init__(self, completed: Any) -> None:
        if completed.exception is not None and not isinstance(completed.exception, (SystemExit, UserError)):
            raise completed.exception
        refused = completed.exception if isinstance(completed.exception, UserError) else None
        self.out = completed.stdout
        self.code = int(refused.code) if refused else completed.exit_code
        self.err = f"{refused} {refused.hint or ''}" if refused else completed.stderr

    @property
    def json(self) -> Any:
        return json.loads(self.out)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the home of a user without any skills."""
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.setenv("HOME", str(folder))
    monkeypatch.delenv("CLAUDE_CONFIG_DIR", raising=False)
    return folder


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Return the top of a project, which has a blank in its path."""
    folder = tmp_path / "my project"
    (folder / ".git").mkdir(parents=True)
    return folder


@pytest.fixture
def skills(project: Path, home: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Answer]:
    """Return a function that runs `xpl skills` in the project."""

    def run(*arguments: str | Path, cwd: Path = project) -> Answer:
        monkeypatch.chdir(cwd)
        return Answer(CliRunner().invoke(app, ["skills", *map(str, arguments)]))

    return run


def _tree(folder: Path) -> dict[str, bytes | str]:
    entries: dict[str, bytes | str] = {}
    for path in folder.rglob("*"):
        if path.is_symlink():
            entries[str(path.relative_to(folder))] = str(path.readlink())
        elif path.is_file():
            entries[str(path.relative_to(folder))] = path.read_bytes()
    return entries


# -- the bundles -------------------------------------------------------------------------------------------------------


def test_there_are_five_skills() -> None:
    """The names are part of the interface: people and agents call skills by them."""
    assert [skill.name for skill in bundles.bundles()] == NAMES


@each_skill
def test_a_skill_is_valid_of_this_version_and_reaches_its_references(skill: bundles.SkillBundle) -> None:
    """An agent that reads a stale copy can tell; a file that nothing points to is never read."""
    assert specification.problems(skill.folder) == []
    assert skill.version == xpl.__version__
    assert skill.references
    for path in skill.references:
        assert f"({bundles.REFERENCES}/{path.name})" in skill.body, f"{path.name} is linked nowhere"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name: a\n", "must begin with a line of three hyphens"),
        ("---\nname: a\n", "no closing line"),
        ("---\nname: [\n---\n", "no YAML"),
        ("---\n- name\n---\n", "must be a mapping"),
        ("---\ndescription: d\n---\n", "name is missing"),
        ("---\nname: other\ndescription: d\n---\n", "differs from that of its folder"),
        ("---\nname: My_Skill\ndescription: d\n---\n", "must be lower-case letters"),
        ("---\nname: my--skill\ndescription: d\n---\n", "must be lower-case letters"),
        ("---\nname: -my-skill\ndescription: d\n---\n", "must be lower-case letters"),
        ("---\nname: " + 65 * "a" + "\ndescription: d\n---\n", "65 characters, more than 64"),
        ("---\nname: my-skill\n---\n", "description is missing"),
        ("---\nname: my-skill\ndescription: ' '\n---\n", "description is missing"),
        ("---\nname: my-skill\ndescription: " + 1025 * "d" + "\n---\n", "1025 characters, more than 1024"),
        ("---\nname: my-skill\ndescription: a <b>\n---\n", "angle bracket"),
        ("---\nname: my-skill\ndescription: d\ntriggers: x\n---\n", "unknown key 'triggers'"),
        ("---\nname: my-skill\ndescription: d\ncompatibility: ''\n---\n", "compatibility must be"),
        (
            "---\nname: my-skill\ndescription: d\nmetadata: {version: 1.0}\n---\n",
            "metadata must map strings to strings",
        ),
        ("---\nname: my-skill\ndescription: d\nlicense: [MIT]\n---\n", "license must be a string"),
        ("---\nname: my-skill\ndescription: d\n---\n[x](../other/a.md)\n", "which is outside the skill"),
        ("---\nname: my-skill\ndescription: d\n---\n[x](references/none.md)\n", "which does not exist"),
        ("---\nname: my-skill\ndescription: d\n---\n[x](references/deep/a.md)\n", "more than one folder deep"),
    ],
)
def test_what_is_wrong_with_a_skill_is_said(tmp_path: Path, text: str, told: str) -> None:
    folder = tmp_path / "my-skill"
    (folder / "references" / "deep").mkdir(parents=True)
    (folder / "references" / "deep" / "a.md").write_text("", encoding="utf-8")
    (folder / bundles.FILE).write_text(text, encoding="utf-8")
    assert [problem.message for problem in specification.problems(folder) if told in problem.message]


def test_a_misspelt_file_name_is_told(tmp_path: Path) -> None:
    """Agents look for SKILL.md, also where the file system takes skill.md for the same."""
    (tmp_path / "skill.md").write_text("---\nname: x\n---\n", encoding="utf-8")
    (problem,) = specification.problems(tmp_path)
    assert problem.dropped


# -- list and get ------------------------------------------------------------------------------------------------------


def test_skills_are_listed_and_printed(skills: Callable[..., Answer]) -> None:
    listed = skills("list", "--json").json
    assert [entry["name"] for entry in listed["skills"]] == NAMES
    short, full = skills("get", NAMES[0]), skills("get", NAMES[0], "--full")
    assert short.out.startswith("# ")
    assert "--full" in short.err
    assert full.out.startswith(short.out.rstrip("\n"))
    reference = bundles.bundles()[0].references[0]
    assert reference.read_text(encoding="utf-8").strip() in full.out
    assert skills("get", NAMES[0], "--full", "--json").json["text"] == full.out


def test_an_unknown_skill_names_the_nearest(skills: Callable[..., Answer]) -> None:
    completed = skills("get", "xpl-audit-polcy")
    assert completed.code == 3
    assert "did you mean xpl-audit-policy?" in completed.err


# -- install -----------------------------------------------------------------------------------------------------------


def test_skills_lie_where_agents_look(skills: Callable[..., Answer], project: Path) -> None:
    assert skills("install").code == 0
    for name in NAMES:
        stored, link = project / ".agents/skills" / name, project / ".claude/skills" / name
        assert bundles.read(stored).name == name
        assert not (stored / "evals").exists()
        assert str(link.readlink()) == f"../../.agents/skills/{name}"
        assert specification.problems(stored) == specification.problems(link) == []
    moved = project.rename(project.parent / "moved")
    assert (moved / ".claude/skills" / NAMES[0] / bundles.FILE).is_file()


def test_skills_go_to_the_top_of_the_work_tree_once(skills: Callable[..., Answer], project: Path) -> None:
    inside = project / "policy" / "Foo"
    inside.mkdir(parents=True)
    assert skills("install", cwd=inside).code == 0
    assert not (inside / ".agents").exists()
    before = _tree(project)
    again = skills("install", "--json")
    assert again.code == 0
    assert {item["state"] for item in again.json["items"]} == {"unchanged"}
    assert _tree(project) == before


def test_only_what_is_named_is_installed(skills: Callable[..., Answer], project: Path) -> None:
    assert skills("install", NAMES[1], "--agent", "codex").code == 0
    assert [path.name for path in (project / ".agents/skills").iterdir()] == [NAMES[1]]
    assert not (project / ".claude").exists()


def test_skills_for_all_projects_of_a_user(skills: Callable[..., Answer], project: Path, home: Path) -> None:
    assert skills("install", "--user").code == 0
    assert (home / ".claude/skills" / NAMES[0] / bundles.FILE).is_file()
    assert (home / ".agents/skills" / NAMES[0] / bundles.FILE).is_file()
    assert not list(home.glob("*.md"))
    assert not list(project.glob("*.md"))
    assert skills("check").code == 0


def test_claude_codes_own_folder_is_found(
    skills: Callable[..., Answer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CLAUDE_CONFIG_DIR", str(tmp_path / "elsewhere"))
    assert skills("install", "--user").code == 0
    assert (tmp_path / "elsewhere/skills" / NAMES[0] / bundles.FILE).is_file()


def test_a_trial_run_writes_nothing_and_a_project_keeps_its_own_agents_file(
    skills: Callable[..., Answer], project: Path
) -> None:
    (project / "CLAUDE.md").write_text("# Mine\n", encoding="utf-8")
    (project / "AGENTS.md").write_text("# Mine\n", encoding="utf-8")
    before = _tree(project)
    completed = skills("install", "--dry-run", "--json")
    assert {item["state"] for item in completed.json["items"]} == {"written", "linked", "left"}
    assert _tree(project) == before
    skills("install")
    assert (project / "AGENTS.md").read_text(encoding="utf-8") == f"# Mine\n\n{instructions.block()}\n"


def test_copies_instead_of_links(skills: Callable[..., Answer], project: Path) -> None:
    assert skills("install", "--copy").code == 0
    copy = project / ".claude/skills" / NAMES[0]
    assert not copy.is_symlink()
    assert bundles.read(copy).name == NAMES[0]
    assert skills("install").code == 0
    assert not copy.is_symlink()


def test_copies_where_links_do_not_work(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system without links says so when the first one is made."""

    def refuse(self: Path, target: str, *, target_is_directory: bool = False) -> None:
        raise PermissionError(1, "Operation not permitted", str(self))

    monkeypatch.setattr(Path, "symlink_to", refuse)
    results = installation.Installation(project, "project").install(bundles.bundles()[:1], ["claude"])
    assert [item.state for item in results] == ["written", "copied"]
    assert bundles.read(project / ".claude/skills" / NAMES[0]).name == NAMES[0]


def _age(place: Path) -> None:
    """Make an installed skill that of an older version: other text, and a stamp that fits it."""
    path = place / bundles.FILE
    path.write_text(path.read_text(encoding="utf-8") + "\nAn older text.\n", encoding="utf-8")
    stamped = place / bundles.STAMP
    noted = json.loads(stamped.read_text(encoding="utf-8"))
    digests = installation._digests(bundles.contents(place))
    stamped.write_text(json.dumps({**noted, "version": "0.0.9", "files": digests}), encoding="utf-8")


def test_an_older_copy_is_renewed(skills: Callable[..., Answer], project: Path) -> None:
    skills("install")
    place = project / ".agents/skills" / NAMES[0]
    _age(place)
    assert skills("check").code == 1
    completed = skills("install", "--json")
    assert completed.code == 0
    assert [item["path"] for item in completed.json["items"] if item["state"] == "renewed"] == [str(place)]
    assert skills("check").code == 0


def test_an_edited_copy_is_its_users(skills: Callable[..., Answer], project: Path) -> None:
    skills("install")
    path = project / ".agents/skills" / NAMES[0] / bundles.FILE
    path.write_text("mine", encoding="utf-8")
    completed = skills("install")
    assert completed.code == 1
    assert path.read_text(encoding="utf-8") == "mine"
    assert "--overwrite" in completed.out
    assert skills("install", "--overwrite").code == 0
    assert path.read_text(encoding="utf-8") != "mine"


@pytest.mark.parametrize("folder", [".agents/skills", ".claude/skills"])
def test_what_is_not_ours_is_never_replaced(skills: Callable[..., Answer], project: Path, folder: str) -> None:
    path = project / folder / NAMES[0] / bundles.FILE
    path.parent.mkdir(parents=True)
    path.write_text("somebody else's", encoding="utf-8")
    completed = skills("install", "--overwrite")
    assert completed.code == 1
    assert path.read_text(encoding="utf-8") == "somebody else's"
    assert (project / folder / NAMES[1] / bundles.FILE).is_file()


def test_a_link_to_elsewhere_is_left(skills: Callable[..., Answer], project: Path, tmp_path: Path) -> None:
    links = project / ".claude/skills"
    links.mkdir(parents=True)
    (links / NAMES[0]).symlink_to(tmp_path / "nowhere")
    assert skills("install", "--overwrite").code == 1
    assert (links / NAMES[0]).readlink() == tmp_path / "nowhere"


def test_a_place_that_cannot_be_written_is_told(skills: Callable[..., Answer], project: Path) -> None:
    (project / ".agents").write_text("a file", encoding="utf-8")
    completed = skills("install")
    assert completed.code == 4
    assert ".agents" in completed.err


def test_one_link_for_the_whole_folder_is_as_good(skills: Callable[..., Answer], project: Path) -> None:
    (project / ".claude").mkdir()
    (project / ".claude/skills").symlink_to("../.agents/skills")
    assert skills("install").code == 0
    assert skills("check").code == 0
    assert not (project / ".agents/skills" / NAMES[0]).is_symlink()


@pytest.mark.parametrize(
    ("arguments", "code"),
    [(["--agent", "emacs"], 2), (["--user", "--dir", "."], 2), (["--dir", "nowhere"], 3), (["xpl-nothing"], 3)],
)
def test_wrong_calls_are_refused(skills: Callable[..., Answer], arguments: list[str], code: int) -> None:
    completed = skills("install", *arguments)
    assert completed.code == code
    assert completed.err
    assert not completed.out


# -- the rules that always apply ---------------------------------------------------------------------------------------


def test_instructions_are_written_and_imported(skills: Callable[..., Answer], project: Path) -> None:
    skills("install")
    assert (project / "AGENTS.md").read_text(encoding="utf-8") == instructions.block() + "\n"
    assert (project / "CLAUDE.md").read_text(encoding="utf-8") == "@AGENTS.md\n"


def test_around_the_block_nothing_changes(skills: Callable[..., Answer], project: Path) -> None:
    path = project / "AGENTS.md"
    before, after = b"# Mine\r\n\nUse tabs, caf\xe9.\n\n", b"\n\nAnd spaces.  \n"
    path.write_bytes(before + b"<!-- xpl: begin. Written long ago. -->\nold\n<!-- xpl: end -->" + after)
    path.chmod(0o600)
    assert skills("check").code == 3
    skills("install")
    assert path.read_bytes() == before + instructions.block().encode() + after
    assert path.stat().st_mode & 0o777 == 0o600


def test_somebodys_own_claude_file_is_left(skills: Callable[..., Answer], project: Path) -> None:
    path = project / "CLAUDE.md"
    path.write_text("# Mine\n", encoding="utf-8")
    completed = skills("install")
    assert completed.code == 1
    assert "@AGENTS.md" in completed.out
    assert path.read_text(encoding="utf-8") == "# Mine\n"
    checked = skills("check", "--json")
    assert checked.code == 0
    assert [(finding["kind"], finding["fails"]) for finding in checked.json["findings"]] == [("rules", False)]
    path.write_text("# Mine\n\nRead @AGENTS.md first.\n", encoding="utf-8")
    assert skills("install").code == 0


@pytest.mark.parametrize(("memory", "text"), [(".claude/CLAUDE.md", "@../AGENTS.md\n"), ("CLAUDE.md", None)])
def test_other_ways_to_import_are_understood(
    skills: Callable[..., Answer], project: Path, memory: str, text: str | None
) -> None:
    (project / "AGENTS.md").write_text("# Mine\n", encoding="utf-8")
    (project / ".claude").mkdir()
    path = project / memory
    path.symlink_to("AGENTS.md") if text is None else path.write_text(text, encoding="utf-8")
    assert skills("install").code == 0
    assert skills("check").code == 0
    assert path.is_symlink() == (text is None)
    assert "xpl: begin" in (project / "AGENTS.md").read_text(encoding="utf-8")


def test_instructions_may_be_left_out(skills: Callable[..., Answer], project: Path) -> None:
    assert skills("install", "--no-instructions").code == 0
    assert not list(project.glob("*.md"))
    assert skills("check").code == 0


# -- check -------------------------------------------------------------------------------------------------------------


def test_nothing_to_check(skills: Callable[..., Answer]) -> None:
    completed = skills("check")
    assert completed.code == 3
    assert "xpl skills install" in completed.err


def _stale(project: Path) -> None:
    _age(project / ".agents/skills" / NAMES[0])


def _edited(project: Path) -> None:
    path = project / ".agents/skills" / NAMES[0] / bundles.FILE
    path.write_text(path.read_text(encoding="utf-8") + "mine\n", encoding="utf-8")


def _foreign(project: Path) -> None:
    _edited(project)
    (project / ".agents/skills" / NAMES[0] / bundles.STAMP).unlink()


def _broken(project: Path) -> None:
    link = project / ".claude/skills" / NAMES[0]
    link.unlink()
    link.symlink_to("nowhere")


def _unlinked(project: Path) -> None:
    (project / ".claude/skills" / NAMES[0]).unlink()


def _dropped(project: Path) -> None:
    path = project / ".agents/skills" / NAMES[0] / bundles.FILE
    path.write_text(path.read_text(encoding="utf-8").replace("name: xpl-", "name: XPL-"), encoding="utf-8")


def _old_rules(project: Path) -> None:
    path = project / "AGENTS.md"
    path.write_text(path.read_text(encoding="utf-8").replace("Always:", "Mostly:"), encoding="utf-8")


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (_stale, "stale"),
        (_edited, "edited"),
        (_foreign, "foreign"),
        (_broken, "broken"),
        (_unlinked, "unlinked"),
        (_dropped, "dropped"),
        (_old_rules, "rules"),
    ],
)
def test_what_keeps_a_skill_from_agents_is_found(
    skills: Callable[..., Answer], project: Path, spoil: Callable[[Path], None], kind: str
) -> None:
    skills("install")
    assert skills("check").code == 0
    spoil(project)
    completed = skills("check", "--json")
    assert completed.code == 1
    findings = [finding for finding in completed.json["findings"] if finding["kind"] == kind]
    assert findings
    assert all(finding["fails"] and finding["fix"] for finding in findings)
    assert skills("check").out.startswith("FAIL")


def test_other_peoples_skills_are_told_and_fail_nothing(skills: Callable[..., Answer], project: Path) -> None:
    skills("install")
    folder = project / ".agents/skills"
    for number in range(12):
        other = folder / f"other-{number}"
        other.mkdir()
        text = f"---\nname: other-{number}\ndescription: {'words ' * 120}\n---\n"
        (other / bundles.FILE).write_text(text, encoding="utf-8")
    (folder / "other-0" / bundles.FILE).write_text("---\nname: another\ndescription: d\n---\n", encoding="utf-8")
    (folder / "lost").symlink_to("nowhere")
    completed = skills("check", "--json")
    assert completed.code == 0
    assert sorted(finding["kind"] for finding in completed.json["findings"]) == ["broken", "budget", "dropped"]
    lengths = {listing["agent"]: listing for listing in completed.json["listings"]}
    assert lengths["codex"]["characters"] > lengths["codex"]["budget"]
    assert lengths["claude"]["skills"] == len(NAMES)


def test_a_skill_counts_once_in_an_agents_list(skills: Callable[..., Answer]) -> None:
    skills("install")
    for listing in skills("check", "--json").json["listings"]:
        assert listing["skills"] == len(NAMES)


# -- this repository ---------------------------------------------------------------------------------------------------


def test_this_repository_follows_its_own_rules(home: Path) -> None:
    from xpl_cli.agents.skills.check import SkillCheck

    assert SkillCheck(ROOT, home).findings() == []
    assert (ROOT / ".claude/skills" / NAMES[0]).is_symlink()
