from __future__ import annotations

import threading
from pathlib import Path

from sqlalchemy import make_url

from service.schedules.jobs import JobQueue

DEADLINE_S = 30.0


def test_jobs_of_a_bus_come_in_the_order_of_their_checks(quick_path: Path, database_url: str) -> None:
    url = None if database_url.startswith("sqlite") else make_url(database_url)
    carried: list[int] = []
    begun, go_on, done = threading.Event(), threading.Event(), threading.Event()

    def carry_out(check_id: int) -> str:
        carried.append(check_id)
        begun.set()
        assert go_on.wait(DEADLINE_S)
        if len(carried) == 5:
            done.set()
        return "completed"

    queue = JobQueue(quick_path, url, "", 1, carry_out)
    queue.start()
    try:
        queue.enqueue("8:p", "bus", 8)
        assert begun.wait(DEADLINE_S)
        for check_id in (11, 9, 12, 10):  # as their ids are sorted as text, 9 would come last
            queue.enqueue(f"{check_id}:p", "bus", check_id)
        go_on.set()
        assert done.wait(DEADLINE_S), carried
    finally:
        go_on.set()
        queue.close()
    assert carried == [8, 9, 10, 11, 12]
