"""Asking as an agent does: what it sees, and a plan that there is."""

from __future__ import annotations

import base64
import itertools
import json
from typing import Any

from mcp import Client
from mcp.types import CallToolResult


def text(result: CallToolResult) -> str:
    return "\n".join(block.text for block in result.content if block.type == "text")


def picture(result: CallToolResult) -> bytes:
    (image,) = [block for block in result.content if block.type == "image"]
    assert image.mime_type == "image/jpeg"
    return base64.b64decode(image.data)


def data(result: CallToolResult) -> dict[str, Any]:
    assert not result.is_error, text(result)
    assert result.structured_content is not None
    return result.structured_content


def refusal(result: CallToolResult) -> dict[str, Any]:
    assert result.is_error, f"not refused: {text(result)}"
    assert result.structured_content is None, "it would have to fit the schema of the tool's answers"
    _, as_data = [block.text for block in result.content if block.type == "text"]
    return json.loads(as_data)["error"]


async def look(client: Client) -> dict[str, Any]:
    return data(await client.call_tool("look", {}))


async def planned(client: Client, besides: tuple[int, str, int] | None = None) -> tuple[CallToolResult, tuple[int, str, int]]:
    """The first plan that there is for one object by another; what was asked."""
    seen = await look(client)
    numbers = [thing["number"] for thing in seen["objects"]]
    for (moved, anchor), relation in itertools.product(itertools.permutations(numbers, 2), ("left_of", "right_of", "behind")):
        wish = (moved, relation, anchor)
        holds_already = anchor in next(thing for thing in seen["objects"] if thing["number"] == moved)["relations"].get(relation, [])
        if holds_already or wish == besides:
            continue
        goal = [{"relation": relation, "to": anchor}]
        result = await client.call_tool("plan", {"scene": seen["scene"], "move": moved, "goal": goal})
        if data(result)["plan"] is not None:
            return result, wish
    raise AssertionError("there is no plan in this cell")
