"""Reading the audit log again: is the chain whole, and where is it not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from drivers.motion.audit_entries import Entry, chain_start, read_entry
from drivers.motion.audit_log import SUFFIX
from valve.errors import NotFoundError
from valve.messages import message_of, say


class Verdict(StrEnum):
    """What is known of a chain; the value is the sentence."""

    WHOLE = "every entry is as it was written"
    TORN = "every entry is as it was written; a crash cut the last one short, which the next entry will tell"
    TAMPERED = "the log was changed after it was written: compare it with a backup"


@dataclass(frozen=True, slots=True)
class Finding:
    """One file of the log: its whole entries, the last one's hash, and where it is wrong if it is."""

    file: Path
    verdict: Verdict
    entries: int
    head: str
    reason: str = ""


def files_of(folder: Path) -> list[Path]:
    """Files of the log in a folder, one a gateway. Raises NotFoundError where there is none."""
    found = sorted(folder.glob(f"*{SUFFIX}"))
    if not found:
        raise NotFoundError(
            say(
                "no_audit_log",
                "{folder}: no audit log is here (*{suffix}): name the folder audit in the store",
                folder=str(folder),
                suffix=SUFFIX,
            )
        )
    return found


def entries_of(path: Path) -> Iterator[Entry]:
    """Entries of one file in order, those that cannot be read left out (``verify`` tells of them)."""
    with path.open("rb") as file:
        for line in file:
            try:
                yield read_entry(line)[0]
            except (ValueError, TypeError):
                continue


def verify(path: Path, expected_head: str | None = None) -> Finding:
    """Return what one file of the log is worth.

    ``expected_head``, a hash that was noted elsewhere, must still stand in it: this tells of an end that was cut off.
    """
    head, count = chain_start(path.name.removesuffix(SUFFIX)), 0
    seen = expected_head in (None, head)
    verdict = Verdict.WHOLE
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):
                verdict = Verdict.TORN
                break
            entry, reason = _followed(line, head, count)
            if entry is None:
                return Finding(
                    path, Verdict.TAMPERED, count, head, say("in_line", "line {n}: {reason}", n=number, reason=reason)
                )
            head, count = entry.hash, entry.n
            seen = seen or head == expected_head
    if expected_head is not None and not seen:
        reason = say(
            "entry_missing",
            "the entry {entry} that was noted is not in it: its end was cut off or rewritten",
            entry=expected_head[:12],
        )
        return Finding(path, Verdict.TAMPERED, count, head, reason)
    return Finding(path, verdict, count, head)


def _followed(line: bytes, head: str, count: int) -> tuple[Entry | None, str]:
    """Return the entry that follows ``head``; None and what is wrong where it does not."""
    try:
        entry, stated = read_entry(line)
    except (ValueError, TypeError) as error:
        return None, say("no_entry", "it is no entry ({why})", why=message_of(error))
    if stated != entry.hash:
        return None, say("entry_changed", "entry {n} is not what its hash says: it was changed", n=entry.n)
    if entry.previous != head or entry.n != count + 1:
        return None, say(
            "entry_does_not_follow",
            "entry {n} does not follow entry {last}: something was removed, put in or moved there",
            n=entry.n,
            last=count,
        )
    return entry, ""
