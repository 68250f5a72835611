from __future__ import annotations

import io
import json

from simulator.record import Event, Happening, RecordFile, ValveRecord


def test_a_record_keeps_the_latest_events_and_positions_in_order_and_no_more() -> None:
    record = ValveRecord("A", events=5, positions=4)
    for i in range(11):
        record.add(Event(float(i), "A", Happening.COMMANDED))
        record.look(float(i), i + 0.1, i + 0.2, i + 0.3)
    assert [event.time_s for event in record.events] == [6.0, 7.0, 8.0, 9.0, 10.0]
    assert record.track.time_s.tolist() == [7.0, 8.0, 9.0, 10.0]
    assert record.track.asked_pa.tolist() == [7.3, 8.3, 9.3, 10.3]


def test_a_record_file_gets_every_event_and_each_position_that_changed() -> None:
    file, record = io.StringIO(), ValveRecord("A")
    RecordFile(file).attach(record)
    record.look(1.0, 0.01, 5.0, 5.0)
    record.look(2.0, 0.01, 5.0, 5.0)
    record.add(Event(2.5, "A", Happening.COMMANDED, 1, 32, (0, 5), 7.0, 5))
    record.look(3.0, 0.01, 5.0, 7.0)
    lines = [json.loads(line) for line in file.getvalue().splitlines()]
    assert [line["time_s"] for line in lines] == [1.0, 2.5, 3.0]
    clocks = [(lines[i].pop("monotonic_s"), lines[i].pop("wall")) for i in range(3)]
    assert clocks == sorted(clocks)
    assert lines[1] == {
        "time_s": 2.5,
        "tag": "A",
        "happening": "commanded",
        "device_id": 1,
        "address": 32,
        "words": [0, 5],
        "pressure_pa": 7.0,
        "run": 5,
    }
    assert lines[2]["asked_pa"] == 7.0
