"""What demonstrations say of a package, without the processes of an audit: its model answers in this one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest import mock

from xpl import get_embodiment
from xpl.action import ActionError
from xpl.client import PolicyServerError
from xpl.episodes import EpisodeCounter
from xpl.observation import ObservationError
from xpl.wire import packed
from xpl.worker.loading import load_model_class
from xpl.worker.perturbed_answers import PerturbedModel
from xpl_cli.audit.engine.checks import Checks
from xpl_cli.audit.offline.demonstrations.fact import DemonstrationComparison
from xpl_cli.audit.offline.search.loaded_adapter import LoadedAdapter
from xpl_cli.audit.rules.facts import Facts
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.rules.registry import find
from xpl_cli.packages.package import load

if TYPE_CHECKING:
    from xpl_cli.audit.rules.model import RuleResult


class Local:
    """A model in this process that answers as a client of its server does, and what is asked of it."""

    def __init__(self, package: Path, demos: Path) -> None:
        self.package, self.options = load(package), AuditOptions(gates=(Gate.OFFLINE,), demos=demos)
        self.config = self.package.config({})
        self.embodiment = get_embodiment(self.config["env_cfg_type"])
        self.action_type = self.config["action_type"]
        self.profile = SimpleNamespace(name=Profile.FULL)
        self.required = self.package.manifest.required
        self.model = load_model_class(package)({**self.config, "manifest": self.package.manifest.data})

    def server(self) -> Any:
        """Return what would be connected to."""
        return SimpleNamespace(url="")

    @contextmanager
    def session(self) -> Iterator[Any]:
        """Yield what answers."""
        yield self

    def connected(self, _url: str) -> Any:
        """Return what answers, as if nothing had been asked before."""
        self.model.reset()
        self.model._episodes = EpisodeCounter()
        return self.session()

    def reset(self) -> Any:
        """Begin an episode."""
        return self.model.reset()

    def __getattr__(self, name: str) -> Any:
        method = getattr(self.model, name)

        def asked(*arguments: Any) -> Any:
            try:
                return method(*arguments)
            except (ActionError, ObservationError, ValueError) as error:
                return PolicyServerError("call_failed", f"{type(error).__name__}: {error}")

        return asked

    def infer(self, obs: Any) -> Any:
        """Show an observation and ask about it."""
        told = self.__getattr__("update_obs")(obs)
        return told if isinstance(told, PolicyServerError) else self.__getattr__("get_action")()

    def blocks(self, again: Any, tried: Any, questions: Any, seconds: float) -> Any:
        """Return the answers under each block, as the errand does; the model is as it was afterwards."""
        replay, asked = again._replay, PerturbedModel(self.model, again._block)
        order = {"blocks": tried, "seconds": seconds, **replay.worker_request(replay.calls_for(questions), set())}
        why, *answers = [packed.decode(one).get("result") for one in asked.answers(order)]
        if why is not None:
            return None
        return [None if one is None else dict(zip(sorted(questions), one, strict=True)) for one in answers]


@dataclass
class Judged:
    """A package and what demonstrations say of it.

    Attributes:
        package: its folder.
        demos: the folder of episodes.
    """

    package: Path
    demos: Path

    @cached_property
    def probe(self) -> Local:
        """The model."""
        return Local(self.package, self.demos)

    @cached_property
    def fact(self) -> DemonstrationComparison:
        """What it answers in the episodes."""
        return DemonstrationComparison(self.probe)  # type: ignore[arg-type]

    @cached_property
    def fit(self) -> RuleResult:
        """What XPL270 says."""
        return self._checked("demonstrations-fit")

    @cached_property
    def followed(self) -> RuleResult:
        """What XPL271 says."""
        return self._checked("demonstrations-followed")

    def _checked(self, slug: str) -> RuleResult:
        facts = {"path": self.package, "demonstrations": self.fact, "options": self.probe.options}

        def answers(again: Any, tried: Any, questions: Any, seconds: float) -> Any:
            return self.probe.blocks(again, tried, questions, seconds)

        with mock.patch.object(LoadedAdapter, "answers_by_block", answers):
            return Checks(Facts(facts, {}))._run_check(find(slug))  # type: ignore[arg-type]
