"""What the journal of an interrupted test keeps, and that journals of an older version are still read."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest

from drivers.bus import Exchange
from drivers.motion.journal import JournalWriter, read_journal, recording_from_journal, was_commanded
from drivers.outcome import Sample
from drivers.rows import PolledRows
from valve.errors import RecordingError
from valve.recording import Acquisition, Provenance


def _polled() -> PolledRows:
    rows = PolledRows(100.0)
    for i in range(20):
        at_s = 100.0 + 0.02 * i
        write = None if i % 5 == 0 else Exchange((), at_s, at_s + 0.003)
        command_pa = 2.0e4 + 10.0 * i
        rows.add(Sample(at_s + 0.004, at_s + 0.007, 0.001 * i, 2.0e4 + i, command_pa), command_pa, write, 0.0)
    return rows


def test_an_interrupted_polled_test_keeps_between_when_each_command_was_written(tmp_path: Path) -> None:
    rows, path = _polled(), tmp_path / "x.journal"
    block = rows.fresh()
    assert block is not None
    journal = JournalWriter(path, {"valve": "FV-101"})
    journal.append(block)
    journal.close()
    kept, whole = recording_from_journal(path), rows.recording(Provenance())
    assert kept is not None
    assert whole is not None
    for name in ("time_s", "position_m", "command_pa", "sent_s", "received_s", "write_sent_s", "written_s"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(whole, name), err_msg=name)
    assert kept.write_sent_s is not None
    assert np.isnan(kept.write_sent_s[::5]).all()
    assert np.isfinite(kept.write_sent_s[1:5]).all()


def test_a_journal_shows_whether_the_valve_may_have_moved(tmp_path: Path) -> None:
    path = tmp_path / "x.journal"
    assert was_commanded(path) is False
    journal = JournalWriter(path, {"valve": "FV-101"})
    assert was_commanded(path) is False
    journal.note_commanded()
    assert was_commanded(path) is True
    block = _polled().fresh()
    assert block is not None
    journal.append(block)
    journal.close()
    assert was_commanded(path) is True
    assert read_journal(path)[1].shape == (20, 9)
    whole = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(whole[0] + whole[1][:-4])  # cut short: it was not on disk when the process died
    assert was_commanded(path) is False


def test_a_journal_of_an_older_version_does_not_say_whether_the_valve_moved(tmp_path: Path) -> None:
    path = tmp_path / "old.journal"
    path.write_bytes(_old_line(json.dumps({"schema": "breakaway/journal/2", "valve": "FV-101"})))
    assert was_commanded(path) is None


@pytest.mark.parametrize(
    ("damage", "shown"),
    [
        ((), True),
        ((0,), True),  # its intent can be read: the valve was commanded, whatever else is damaged
        ((1,), None),
        ((0, 1), None),
        ((2, 3), True),
    ],
)
def test_a_flipped_byte_makes_a_journal_doubtful_and_never_says_that_nothing_was_commanded(
    tmp_path: Path, damage: tuple[int, ...], shown: bool | None
) -> None:
    path = tmp_path / "x.journal"
    journal = JournalWriter(path, {"valve": "FV-101"})
    journal.note_commanded()
    block = _polled().fresh()
    assert block is not None
    journal.append(block)
    journal.close()
    lines = path.read_bytes().splitlines(keepends=True)
    for place in damage:
        lines[place] = bytes([lines[place][0] ^ 0x01]) + lines[place][1:]
    path.write_bytes(b"".join(lines))
    assert was_commanded(path) is shown
    path.write_bytes(b"".join(lines[:2]))
    assert was_commanded(path) is shown
    path.write_bytes(b"torn")
    assert was_commanded(path) is None


def _old_line(text: str) -> bytes:
    return b"%s %08x\n" % (text.encode(), zlib.crc32(text.encode()))


def test_a_journal_of_the_older_version_is_still_read(tmp_path: Path) -> None:
    path = tmp_path / "old.journal"
    header = {"schema": "breakaway/journal/1", "valve": "FV-101", "entry_pa": 2.0e4}
    lines = [f"{0.02 * i},{0.02 * i},{0.02 * i + 0.003},{0.001 * i},nan,{2.0e4 + i},1.0" for i in range(10)]
    torn = _old_line("0.2,0.2,0.203,0.01")
    path.write_bytes(_old_line(json.dumps(header)) + b"".join(map(_old_line, lines)) + torn)
    assert read_journal(path)[1].shape == (10, 9)
    recording = recording_from_journal(path)
    assert recording is not None
    assert recording.samples == 10
    assert recording.provenance.acquisition is Acquisition.POLLED
    assert (recording.write_sent_s, recording.written_s) == (None, None)
    np.testing.assert_allclose(recording.position_m, 0.001 * np.arange(10))


@pytest.mark.parametrize("schema", ["breakaway/journal/9", [], None])
def test_a_journal_of_a_version_that_is_not_known_is_refused(tmp_path: Path, schema: object) -> None:
    path = tmp_path / "new.journal"
    path.write_bytes(_old_line(json.dumps({"schema": schema})))
    with pytest.raises(RecordingError, match="no header of breakaway/journal/3"):
        read_journal(path)
