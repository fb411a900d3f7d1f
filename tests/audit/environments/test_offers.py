"""What an environment offers, of which an audit tries every task."""

from __future__ import annotations

from tests.support.checkout import ROOT
from xpl_cli.audit.environments.env_probe import EnvProbe
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.basics.progress import Progress


def test_who_waits_is_told_how_many_tasks_are_played_and_how_one_is_audited() -> None:
    """Once, before the first is made; an audit of one task has nothing to say."""
    told: list[str] = []
    stage = EnvProbe(ROOT / "envs" / "metaworld", AuditOptions(progress=Progress(step=told.append)))
    assert len({offer.task for offer in stage.offers}) == 50
    assert stage.offers
    assert [text for text in told if "50 tasks" in text and "--set task=assembly" in text] == told
    assert len(told) == 1
    told.clear()
    one = EnvProbe(
        ROOT / "envs" / "metaworld", AuditOptions(overrides={"task": "reach"}, progress=Progress(step=told.append))
    )
    assert {offer.task for offer in one.offers} == {"reach"}
    assert told == []
