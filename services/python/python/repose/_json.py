"""Requests as they travel."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from .errors import InvalidArgument


def as_json(document: Any, field: str) -> str:
    """Write a document, with arrays and numbers of NumPy as Python's own. NaN is left for whoever reads it to refuse, by its field."""
    try:
        return json.dumps(document, default=_plain)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(f"it cannot travel as JSON: {error}", field) from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"expected numbers, texts, lists and dictionaries, got {type(value).__name__}")
