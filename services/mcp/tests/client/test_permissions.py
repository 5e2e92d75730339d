"""Who may have what carried out: execution off and on, one's own plans and others', scenes that have changed, and the stop, which everybody may."""

from __future__ import annotations

from pathlib import Path

import anyio
import pytest
from asking import data, planned, refusal, text
from conftest import WHO, Cell
from mcp import Client

pytestmark = pytest.mark.anyio


async def execute(client: Client, plan: str) -> dict:
    return refusal(await client.call_tool("execute", {"plan": plan}))


async def test_without_leave_nothing_is_carried_out_and_a_stop_is(cell: Cell) -> None:
    async with cell.agent() as client:
        own = data((await planned(client))[0])["plan"]
        for plan in (own, "made up"):
            error = await execute(client, plan)
            assert error["code"] == "failed_precondition" and "--allow-execute" in error["message"]
        assert data(await client.call_tool("state", {}))["may_execute"] is False
        stopped = data(await client.call_tool("stop", {"reason": "a hand in the cell"}))
        assert (stopped["mode"], stopped["stopped_because"]) == ("stopped", f"agent {WHO.name} {WHO.version}: a hand in the cell")
    cell.bring_back()


@pytest.mark.parametrize("mode", ["auto", "legacy"])
async def test_only_plans_of_this_server_and_session_are_carried_out_once_on_the_scene_they_were_made_on(cell: Cell, mode: str) -> None:
    async with cell.agent("--allow-execute", mode=mode) as client, cell.agent("--allow-execute", mode=mode) as stranger:
        assert "execute" in [tool.name for tool in (await client.list_tools()).tools]
        assert (await execute(client, "made up"))["code"] == "not_found"
        result, wish = await planned(client)
        own, other = data(result)["plan"], data((await planned(client, besides=wish))[0])["plan"]
        assert (await execute(stranger, own))["code"] == "not_found", "another server's"

        done = await client.call_tool("execute", {"plan": own})
        ended = data(done)
        assert ended["outcome"] == "done", text(done)
        assert [held["term"] for held in ended["holds"]] == [f"{wish[1]}:{wish[2]}"]
        assert (await execute(client, own))["code"] == "not_found", "it was carried out already"
        error = await execute(client, other)
        assert (error["code"], error["field"]) == ("failed_precondition", "plan") and "has changed" in error["message"]


async def test_sessions_of_one_server_do_not_carry_out_each_others_plans(cell: Cell, tmp_path: Path) -> None:
    log = tmp_path / "log"
    with cell.server("--allow-execute", log=log) as url:
        async with Client(url, mode="legacy", client_info=WHO) as client, Client(url, mode="legacy") as stranger:
            plan = data((await planned(client))[0])["plan"]
            assert (await execute(stranger, plan))["code"] == "not_found"
    lines = [line for line in log.read_text().splitlines() if "execute" in line and "refused" in line]
    asked = [line for line in log.read_text().splitlines() if "plan" in line and f"{WHO.name} {WHO.version}" in line]
    assert lines and asked, "every call is in the log, with who asked"


async def test_everybody_may_stop_what_another_has_carried_out(cell: Cell) -> None:
    with cell.server("--allow-execute") as url:
        async with Client(url, client_info=WHO, read_timeout_seconds=120) as client, Client(url, mode="legacy") as bystander:
            plan = data((await planned(client))[0])["plan"]
            ended: dict = {}

            async def carry_out() -> None:
                ended.update(data(await client.call_tool("execute", {"plan": plan})))

            async with anyio.create_task_group() as group:
                group.start_soon(carry_out)
                with anyio.fail_after(60):
                    while data(await bystander.call_tool("state", {}))["mode"] != "moving":
                        pass
                assert data(await bystander.call_tool("state", {}))["carrying_out"] is True
                stopped = data(await bystander.call_tool("stop", {"reason": "somebody is in the way"}))
                assert stopped["mode"] == "stopped"
            assert ended["outcome"] == "stopped" and "somebody is in the way" in (ended["reason"] or ""), ended
            assert (await execute(client, plan))["code"] == "not_found", "it is not begun again"
    cell.bring_back()
