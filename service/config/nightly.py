"""Schedules, groups of valves, gateways and retention in plant.toml."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, MutableMapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Final
from zoneinfo import ZoneInfo

from cronsim import CronSim, CronSimError
from pydantic import BaseModel, ConfigDict, Field

from service.config.errors import Findings
from service.model.schedule import Schedule
from valve.messages import joined, say

GATEWAY_VARIABLE: Final = "BREAKAWAY_GATEWAY"
STRICT: Final = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$")]
Tags = Annotated[list[Annotated[str, Field(min_length=1, max_length=64)]], Field(max_length=10000)]


class ScheduleSection(BaseModel):
    """One ``[[schedules]]``."""

    model_config = STRICT
    name: Name
    cron: Annotated[str, Field(min_length=1, max_length=200)]
    zone: Annotated[str, Field(min_length=1, max_length=100)]
    valves: Tags = []
    groups: Tags = []
    sequence: Annotated[str, Field(min_length=1, max_length=64)]
    overrides: dict[str, Any] = {}
    until: Annotated[dict[str, Any], Field(max_length=8)] | None = None
    window_s: Annotated[float, Field(ge=60.0, le=86400.0)]


class GroupSection(BaseModel):
    """One ``[[groups]]``."""

    model_config = STRICT
    name: Name
    valves: Annotated[Tags, Field(min_length=1)]


class GatewaySection(BaseModel):
    """One ``[[gateways]]``."""

    model_config = STRICT
    name: Name
    url: Annotated[str, Field(pattern=r"^https?://[^\s/]+/?$", max_length=200)]


class RetentionSection(BaseModel):
    """``[service.retention]``."""

    model_config = STRICT
    recordings_days: Annotated[int, Field(ge=1, le=36500)]
    keep_baselines: bool = True
    keep_last: Annotated[int, Field(ge=1, le=100000)] = 10


def groups_by_name(
    findings: Findings, raw: Sequence[Mapping[str, Any]], tags: Collection[str]
) -> dict[str, tuple[str, ...] | None]:
    """Return each group's valves; None where its section is wrong, and so not known."""
    groups: dict[str, tuple[str, ...] | None] = {}
    for index, one in enumerate(raw):
        section = findings.model(GroupSection, dict(one), ("groups", index))
        name = one.get("name")
        if isinstance(name, str) and name in groups:
            findings.add(
                ("groups", index, "name"),
                name,
                say("other_group_has_name", "another group has this name"),
                say("rename_one", "rename one"),
            )
        if section is None:
            groups.setdefault(str(name), None)
            continue
        _check_tags(findings, ("groups", index, "valves"), section.valves, tags)
        groups[section.name] = tuple(section.valves)
    return groups


def schedules(
    findings: Findings,
    raw: Sequence[Mapping[str, Any]],
    groups: Mapping[str, tuple[str, ...] | None],
    tags: Collection[str],
) -> dict[int, Schedule]:
    """Return the schedules by their place in the file, each with all its valves in the order of the file.

    One with a wrong zone or time is there too, so that the rest of it can be judged; its fault is noted.
    """
    found: dict[int, Schedule] = {}
    names: set[str] = set()
    for index, one in enumerate(raw):
        key = ("schedules", index)
        section = findings.model(ScheduleSection, dict(one), key)
        if section is None:
            continue
        if section.name in names:
            findings.add(
                (*key, "name"),
                section.name,
                say("other_schedule_has_name", "another schedule has this name"),
                say("rename_one", "rename one"),
            )
        names.add(section.name)
        zone = zone_named(findings, (*key, "zone"), section.zone)
        _check_cron(findings, (*key, "cron"), section.cron)
        _check_tags(findings, (*key, "valves"), section.valves, tags)
        valves, is_known = list(section.valves), True
        for group in section.groups:
            if group not in groups:
                known = joined(", ", groups) if groups else say("none_defined", "none is defined")
                findings.add(
                    (*key, "groups"),
                    group,
                    say("no_group_of_name", "no group has this name"),
                    say("add_group", "add it under [[groups]] ({known})", known=known),
                )
            of_group = groups.get(group)
            is_known = is_known and of_group is not None
            valves += of_group or ()
        if not valves and is_known:
            findings.add(
                (*key, "valves"),
                [],
                say("schedule_of_no_valve", "the schedule checks no valve"),
                say("name_valves_or_groups", "name valves or groups"),
            )
        found[index] = Schedule(
            section.name,
            section.cron,
            zone or ZoneInfo("UTC"),
            tuple(dict.fromkeys(valves)),
            section.sequence,
            section.window_s,
            section.overrides,
            section.until,
        )
    return found


def zone_named(findings: Findings, key: tuple[str | int, ...], name: str) -> ZoneInfo | None:
    """Return the time zone of this name, or None with the fault noted."""
    try:
        return ZoneInfo(name)
    except (KeyError, ValueError, OSError):
        findings.add(
            key,
            name,
            say("no_time_zone", "no time zone has this name"),
            say("give_time_zone", "give one of the IANA database such as Europe/Berlin"),
        )
        return None


def _check_cron(findings: Findings, key: tuple[str | int, ...], cron: str) -> None:
    try:
        next(CronSim(cron, datetime.now(UTC)))
    except (CronSimError, StopIteration) as error:
        reason = str(error) or say("never_comes", "it never comes")
        findings.add(
            key,
            cron,
            say("no_cron_time", "it is no time of cron ({reason})", reason=reason),
            say("give_cron_time", 'give five fields such as "30 1 * * *"'),
        )


def _check_tags(findings: Findings, key: tuple[str | int, ...], wanted: Sequence[str], tags: Collection[str]) -> None:
    for index, tag in enumerate(wanted):
        if tag not in tags:
            findings.add(
                (*key, index),
                tag,
                say("no_valve_of_this_tag", "no valve has this tag"),
                say("correct_or_add_valve", "correct it, or add the valve"),
            )


def name_gateway(service: MutableMapping[str, Any], environment: Mapping[str, str] = os.environ) -> None:
    """Let the environment say which gateway this is, so that several containers read one and the same file."""
    if name := environment.get(GATEWAY_VARIABLE):
        service["gateway"] = name


def gateways(findings: Findings, raw: Sequence[Mapping[str, Any]], own: str | None) -> dict[str, str]:
    """Return each gateway's address; ``own`` is this one's name."""
    found: dict[str, str] = {}
    for index, one in enumerate(raw):
        section = findings.model(GatewaySection, dict(one), ("gateways", index))
        name = one.get("name")
        if isinstance(name, str) and name in found:
            findings.add(
                ("gateways", index, "name"),
                name,
                say("other_gateway_has_name", "another gateway has this name"),
                say("rename_one", "rename one"),
            )
        if isinstance(name, str):  # also one that is wrong: what names it is not wrong because of that
            found[name] = "" if section is None else section.url.rstrip("/")
    if found and own is None:
        findings.add(
            ("service", "gateway"),
            None,
            say("several_gateways", "the plant has several gateways"),
            say("say_which_gateway", "say which this is: {known:, }", known=tuple(found)),
        )
    elif own is not None and own not in found:
        findings.add(
            ("service", "gateway"),
            own,
            say("no_gateway_of_name", "no gateway has this name"),
            say("add_gateway", "add it under [[gateways]] with its url"),
        )
    return found


def gateway_of_bus(findings: Findings, key: tuple[str | int, ...], name: object, known: Mapping[str, str]) -> str:
    """Return whose bus it is: "" in a plant of one gateway."""
    if not known:
        if name is not None:
            findings.add(
                (*key, "gateway"),
                name,
                say("no_gateways", "the plant has no [[gateways]]"),
                say("add_them", "add them, or remove this key"),
            )
        return ""
    if not isinstance(name, str) or name not in known:
        findings.add(
            (*key, "gateway"),
            name,
            say("not_our_gateway", "it is no gateway of this plant"),
            say("choose_one_of", "choose one of {known:, }", known=tuple(known)),
        )
        return ""
    return name
