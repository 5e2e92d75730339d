"""The tools through the official client, over both transports and both of its ways to begin."""

from __future__ import annotations

import subprocess
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from asking import data, look, picture, planned, refusal, text
from conftest import Cell, free_port
from mcp import Client
from mcp.client.streamable_http import streamable_http_client
from mcp.shared._httpx_utils import create_mcp_http_client

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("mode", ["auto", "legacy"])
@pytest.mark.parametrize("transport", ["stdio", "http"])
async def test_an_agent_sees_what_there_is_and_plans_with_it(cell: Cell, transport: str, mode: str) -> None:
    if transport == "stdio":
        async with cell.agent(mode=mode) as client:
            await sees_and_plans(client)
    else:
        with cell.server() as url:
            async with Client(url, mode=mode, read_timeout_seconds=120) as client:
                await sees_and_plans(client)


async def sees_and_plans(client: Client) -> None:
    tools = {tool.name: tool for tool in (await client.list_tools()).tools}
    assert sorted(tools) == ["look", "plan", "state", "stop"], "execution is off unless it is allowed"
    assert tools["look"].annotations is not None and tools["look"].annotations.read_only_hint
    assert tools["plan"].input_schema["properties"].keys() >= {"scene", "say", "move", "goal"}

    looked = await client.call_tool("look", {})
    seen = data(looked)
    assert picture(looked).startswith(b"\xff\xd8\xff")
    assert len(seen["objects"]) >= 2
    for thing in seen["objects"]:
        assert f"object {thing['number']}:" in text(looked)
        assert thing["size_cm"] is None or all(0 < edge < 100 for edge in thing["size_cm"])

    result, (moved, relation, anchor) = await planned(client)
    plan = data(result)
    assert (plan["move"], plan["goal"]) == (moved, [f"{relation}:{anchor}"])
    assert plan["seconds"] > 0 and 0 <= plan["success"] <= 1 and plan["motion"] and plan["evidence"]
    assert picture(result).startswith(b"\xff\xd8\xff")
    in_words = f"put object {moved} {relation.replace('_of', '')} of object {anchor}"
    by_words = await client.call_tool("plan", {"scene": plan["scene"], "say": in_words})
    if relation != "behind":
        assert data(by_words)["goal"] == plan["goal"]
        assert data(by_words)["understood"] == {f"object {moved}": [moved], f"object {anchor}": [anchor]}

    contradiction = [{"relation": "left_of", "to": anchor}, {"relation": "right_of", "to": anchor}]
    none = data(await client.call_tool("plan", {"scene": plan["scene"], "move": moved, "goal": contradiction}))
    assert none["plan"] is None and "rejected" in none["reasons"][0]


async def test_what_cannot_be_is_refused_by_field(cell: Cell) -> None:
    async with cell.agent() as client:
        seen = await look(client)
        cases = [
            ({"move": 1, "goal": [{"relation": "left_of", "to": 2}]}, "scene"),
            ({"scene": seen["scene"], "move": 1, "goal": [{"relation": "beside", "to": 2}]}, "goal[0].relation"),
            ({"scene": seen["scene"], "move": 999, "goal": [{"relation": "left_of", "to": 2}]}, "move"),
            ({"scene": "0123456789ab", "move": 1, "goal": []}, "scene"),
            ({"say": "put the thing somewhere nice"}, "say"),
            ({"joints": [0, 0, 0, 0, 0, 0, 0]}, "joints"),
        ]
        for arguments, field in cases:
            error = refusal(await client.call_tool("plan", arguments))
            assert error["field"] == field, f"{arguments}: {error}"
        assert refusal(await client.call_tool("drive", {}))["code"] == "not_found"


def status(url: str, headers: dict[str, str]) -> int:
    body = b'{"jsonrpc":"2.0","id":1,"method":"tools/list"}'
    plain = {"Content-Type": "application/json", "Accept": "application/json, text/event-stream"}
    request = urllib.request.Request(url, data=body, headers={**plain, **headers}, method="POST")
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


async def test_pages_of_other_sites_and_strangers_are_refused(cell: Cell, tmp_path: Path) -> None:
    with cell.server() as url:
        assert status(url, {"Origin": "http://evil.example"}) == 403
        assert status(url, {"Origin": url.removesuffix("/mcp")}) == 403, "agents are no pages"
        assert status(url, {"Host": "evil.example"}) == 403, "another's name that was given our address"
        assert status(url, {}) not in (401, 403)
    token = tmp_path / "token"
    token.write_text("a-long-agents-token\n")
    with cell.server("--token", str(token)) as url:
        assert status(url, {}) == 401
        assert status(url, {"Authorization": "Bearer a-guess-of-a-token"}) == 401
        headers = {"Authorization": "Bearer a-long-agents-token"}
        async with create_mcp_http_client(headers=headers) as http, Client(streamable_http_client(url, http_client=http)) as client:
            assert (await look(client))["objects"]
    beyond = [cell.program, *cell.arguments("--http", f"0.0.0.0:{free_port()}")]
    refused = subprocess.run(beyond, capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode == 2 and "token" in refused.stderr, refused.stderr
