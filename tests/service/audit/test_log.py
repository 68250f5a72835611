from __future__ import annotations

import multiprocessing
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.motion.audit_entries import canonical
from drivers.motion.audit_log import TORN, AuditError, AuditLog
from service.audit.verify import Verdict, entries_of, verify


@pytest.fixture
def log(tmp_path: Path) -> AuditLog:
    log = AuditLog(tmp_path / "audit")
    for number in range(5):
        log.append("motion.armed", who="anna", valve="FV-101", test=f"t{number}", details={"high_pa": 1.5 * number})
    return log


def test_what_is_appended_is_read_again_in_order_and_the_chain_is_whole(log: AuditLog) -> None:
    AuditLog(log.path.parent).append("motion.ended", who="größe\n✓", details={"nested": [1, {"a": None}]})
    entries = list(entries_of(log.path))
    assert [entry.n for entry in entries] == [1, 2, 3, 4, 5, 6]
    assert (entries[5].event, entries[5].who, entries[5].details) == (
        "motion.ended",
        "größe\n✓",
        {"nested": [1, {"a": None}]},
    )
    found = verify(log.path)
    assert (found.verdict, found.entries, found.head) == (Verdict.WHOLE, 6, entries[5].hash)
    assert log.head == (6, found.head), "the first object sees what the second wrote"


def test_nobody_else_may_read_the_log(log: AuditLog) -> None:
    assert log.path.stat().st_mode & 0o777 == 0o600


def _changed(lines: list[bytes]) -> None:
    lines[2] = lines[2].replace(b"anna", b"otto")


def _changed_last(lines: list[bytes]) -> None:
    lines[4] = lines[4].replace(b"anna", b"otto")


def _removed(lines: list[bytes]) -> None:
    del lines[1]


def _removed_first(lines: list[bytes]) -> None:
    del lines[0]


def _doubled(lines: list[bytes]) -> None:
    lines.insert(3, lines[3])


def _swapped(lines: list[bytes]) -> None:
    lines[1], lines[2] = lines[2], lines[1]


def _not_json(lines: list[bytes]) -> None:
    lines[3] = b"{}\n"


def _spaced(lines: list[bytes]) -> None:
    lines[3] = lines[3].replace(b',"', b', "')


@pytest.mark.parametrize(
    "tamper",
    [_changed, _changed_last, _removed, _removed_first, _doubled, _swapped, _not_json, _spaced],
    ids=lambda one: one.__name__,
)
def test_whatever_is_changed_in_the_log_is_found(log: AuditLog, tamper: Callable[[list[bytes]], None]) -> None:
    lines = log.path.read_bytes().splitlines(keepends=True)
    tamper(lines)
    log.path.write_bytes(b"".join(lines))
    found = verify(log.path)
    assert found.verdict is Verdict.TAMPERED
    assert "line" in found.reason


def test_every_single_flipped_bit_is_found(log: AuditLog) -> None:
    good = log.path.read_bytes()
    for place in range(0, len(good), 7):
        bad = bytearray(good)
        bad[place] ^= 1 << (place % 7)
        log.path.write_bytes(bad)
        found = verify(log.path)
        cut = good[place] == 0x0A and place == len(good) - 1
        assert cut or found.verdict is Verdict.TAMPERED, f"byte {place}"


def test_one_gateways_log_does_not_pass_for_anothers(log: AuditLog) -> None:
    other = log.path.with_name("other.audit")
    shutil.copy(log.path, other)
    assert verify(other).verdict is Verdict.TAMPERED


def test_an_end_that_was_cut_off_is_told_by_a_head_that_was_noted(log: AuditLog) -> None:
    count, head = log.head
    log.append("motion.ended", who="anna")
    assert verify(log.path, head).verdict is Verdict.WHOLE
    lines = log.path.read_bytes().splitlines(keepends=True)
    log.path.write_bytes(b"".join(lines[: count - 1]))
    assert verify(log.path).verdict is Verdict.WHOLE
    found = verify(log.path, head)
    assert found.verdict is Verdict.TAMPERED
    assert "cut off" in found.reason


def test_an_entry_that_a_crash_cut_is_told_apart_from_tampering_at_every_length(log: AuditLog) -> None:
    good = log.path.read_bytes()
    last = good.rindex(b"\n", 0, -1) + 1
    for length in range(last + 1, len(good), 11):
        log.path.write_bytes(good[:length])
        found = verify(log.path)
        assert (found.verdict, found.entries) == (Verdict.TORN, 4)
        AuditLog(log.path.parent).append("service.started", who="service")
        found = verify(log.path)
        assert (found.verdict, found.entries) == (Verdict.WHOLE, 6), "the cut, and what came after"
        told = list(entries_of(log.path))[4]
        assert (told.event, told.details["bytes"]) == (TORN, length - last)
        assert good[last:length].decode() == told.details["text"]


def test_nothing_is_appended_behind_an_entry_that_was_changed(log: AuditLog) -> None:
    log.path.write_bytes(log.path.read_bytes().replace(b"t4", b"t9"))
    with pytest.raises(AuditError, match="changed"):
        AuditLog(log.path.parent)


def test_a_full_disk_is_an_error_and_the_next_entry_tells_of_the_cut_one(
    log: AuditLog, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda descriptor, data: real(descriptor, data[:50]))
        with pytest.raises(AuditError, match="disk"):
            log.append("motion.armed", who="anna")
    log.append("motion.armed", who="anna")
    assert [entry.event for entry in entries_of(log.path)][5:] == [TORN, "motion.armed"]
    assert verify(log.path).verdict is Verdict.WHOLE


@pytest.mark.parametrize("details", [{"x": float("nan")}, {"x": object()}, {"x": "y" * 70_000}])
def test_what_cannot_be_written_is_refused_and_leaves_no_trace(log: AuditLog, details: dict[str, object]) -> None:
    before = log.path.read_bytes()
    with pytest.raises(AuditError):
        log.append("motion.armed", who="anna", details=details)
    assert log.path.read_bytes() == before


def test_a_folder_that_cannot_be_written_and_a_name_that_leaves_it_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AuditError, match="cannot be written"):
        AuditLog(tmp_path / "file")
    with pytest.raises(AuditError, match="name"):
        AuditLog(tmp_path, "../x")


def _append_many(folder: Path) -> None:
    log = AuditLog(folder)
    for _ in range(20):
        log.append("x", who=str(os.getpid()))


def test_processes_that_append_at_once_make_one_chain(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    processes = [context.Process(target=_append_many, args=(tmp_path,)) for _ in range(3)]
    for one in processes:
        one.start()
    for one in processes:
        one.join(30.0)
    found = verify(tmp_path / "gateway.audit")
    assert (found.verdict, found.entries) == (Verdict.WHOLE, 60)


def test_canonical_json_does_not_depend_on_the_order_of_members() -> None:
    assert canonical({"b": 1, "a": {"d": "é", "c": 2}}) == '{"a":{"c":2,"d":"é"},"b":1}'
