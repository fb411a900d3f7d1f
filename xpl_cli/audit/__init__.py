"""The audit: runs the rules of `conformance/GATE/NAME/rule.py`, cheapest gate first.

A rule imports from here and nowhere else in the engine:

    from xpl_cli.audit import Edit, Finding, Fix, NotApplicable, NotRun, Proof, rule
"""

from xpl_cli.audit.rules.model import Edit, Finding, Fix, Location, NotApplicable, NotRun, Outcome, Proof
from xpl_cli.audit.rules.registry import Rule, rule

__all__ = ["Edit", "Finding", "Fix", "Location", "NotApplicable", "NotRun", "Outcome", "Proof", "Rule", "rule"]
