"""What people say of a test afterwards: its label, its work order, a note; who may, and what is kept of it."""

from __future__ import annotations

from pathlib import Path

from service.access.principal import Role
from service.audit.verify import entries_of
from tests.service.access.signed_in import Served, body_of, signed_in
from tests.support.problem import assert_problem

RUN = {"valve": "FV-101", "sequence": "triangle"}


async def _test(served: Served, **more: str) -> str:
    headers = {"Prefer": "wait=10", **served.tokens[Role.OPERATOR]}
    return str(body_of(await served.client.post("/tests/run", json={**RUN, **more}, headers=headers))["href"])


async def test_a_label_is_corrected_later_and_its_former_one_stays_in_the_audit_log(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        client, operator = served.client, served.tokens[Role.OPERATOR]
        address = await _test(served, label="as_found")
        chosen = {"test": address.rpartition("/")[2]}
        engineer = served.tokens[Role.ENGINEER]
        before = body_of(await client.post("/valves/FV-101/baseline", json=chosen, headers=engineer))
        said = {"label": "as_left", "work_order": " WO-4711 ", "note": "Packing\nreplaced <b>today</b>"}
        shown = body_of(await client.patch(address, json=said, headers=operator))
        assert (shown["label"], shown["work_order"]) == ("as_left", "WO-4711")
        assert (shown["note"], shown["described_by"]) == (said["note"], "a-operator")
        assert body_of(await client.get(address, headers=operator)) == shown
        listed = body_of(await client.get("/tests", params={"label": "as_left"}, headers=operator))["tests"]
        assert [one["href"] for one in listed] == [address]
        assert body_of(await client.get("/valves/FV-101/baseline", headers=operator)) == before, "it stays"
        (path,) = (served.config.parent / "plant-data" / "audit").iterdir()
        entry = [one for one in entries_of(path) if one.event == "test.described"][-1]
        assert (entry.who, entry.valve, entry.test) == ("a-operator", "FV-101", shown["id"])
        assert entry.details["was"] == {"label": "as_found", "work_order": None, "note": None}
        assert entry.details["now"]["label"] == "as_left"
        report = await client.get(f"{address}/report", params={"format": "html"}, headers=operator)
        assert "&lt;b&gt;today" in report.text
        assert "WO-4711" in report.text.split("For the engineer")[0]


async def test_what_is_not_named_stays_null_takes_away_and_the_same_again_changes_nothing(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        client, operator = served.client, served.tokens[Role.OPERATOR]
        address = await _test(served, label="as_found")
        first = body_of(await client.patch(address, json={"note": "gland eased"}, headers=operator))
        assert first["label"] == "as_found"
        again = body_of(await client.patch(address, json={"note": "gland eased"}, headers=operator))
        assert again["described_at"] == first["described_at"]
        bare = body_of(await client.patch(address, json={"label": None, "note": "  "}, headers=operator))
        assert (bare["label"], bare["note"]) == (None, None)
        (path,) = (served.config.parent / "plant-data" / "audit").iterdir()
        assert [one.event for one in entries_of(path)].count("test.described") == 2


async def test_nobody_describes_a_test_without_the_right_or_with_words_that_do_not_fit(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        address, words = await _test(served), {"note": "x"}
        for role in (Role.VIEWER, Role.SCHEDULER):
            refused = await served.client.patch(address, json=words, headers=served.tokens[role])
            assert_problem(refused, 403, "acknowledge")
        assert (await served.client.patch(address, json=words)).status_code == 401
        operator = served.tokens[Role.OPERATOR]
        for body in ({"label": "as_bought"}, {"state": "completed"}, {"note": "x" * 2001}, {"work_order": "a\nb"}):
            assert (await served.client.patch(address, json=body, headers=operator)).status_code == 422, body
        unknown = await served.client.patch("/tests/20200101T000000Z-00000000", json=words, headers=operator)
        assert_problem(unknown, 404, "unknown")
        assert body_of(await served.client.get(address, headers=operator))["described_by"] is None
