"""The limits that a valve is judged by: ``[valves.health]`` above its class, ``[classes.NAME]``, above the defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Final

from service.config.errors import Findings, Key
from service.model.health_limits import HealthLimits
from service.words.spelling import nearest
from valve.messages import say

_NAMES: Final = frozenset(one.name for one in fields(HealthLimits))


def health_limits(
    findings: Findings, valves: Sequence[Mapping[str, Any]], classes: Mapping[str, Any]
) -> dict[str, HealthLimits]:
    """Return the limits by tag: a valve's own key stands above its class, the class above the documented default."""
    of_classes = {
        name: _limits(findings, section, ("classes", name), HealthLimits()) for name, section in classes.items()
    }
    limits: dict[str, HealthLimits] = {}
    for index, raw in enumerate(valves):
        base, name = HealthLimits(), raw.get("class")
        if isinstance(name, str):
            if name not in of_classes:
                _note_unknown(findings, ("valves", index, "class"), name, list(of_classes))
            base = of_classes.get(name, base)
        limits[str(raw.get("tag"))] = _limits(findings, raw.get("health"), ("valves", index, "health"), base)
    return limits


def _limits(findings: Findings, section: Any, key: Key, base: HealthLimits) -> HealthLimits:
    """Return ``base`` with what a table says otherwise; what is wrong in it is noted and changes nothing."""
    own = findings.part(HealthLimits, section, key) if isinstance(section, dict) else None
    if own is None:
        return base
    named = findings.si_table(HealthLimits, section, key).keys() & _NAMES
    return replace(base, **{name: getattr(own, name) for name in named})


def _note_unknown(findings: Findings, key: Key, name: str, known: Sequence[str]) -> None:
    if not known:
        findings.add(
            key,
            name,
            say("no_classes", "the plant file has no classes"),
            say("add_class", "add [classes.{name}] with its limits, or remove this key", name=name),
        )
        return
    close = nearest(name, known)
    findings.add(
        key,
        name,
        say("no_class_of_name", "no class has this name; there are {known:, }", known=tuple(known)),
        say("write_close", "write {close}", close=close)
        if close
        else say("choose_or_add_class", "choose one of them, or add [classes.{name}]", name=name),
    )
