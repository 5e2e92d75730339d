"""Requests as they travel."""

from __future__ import annotations

import json
import operator
from typing import Any

import numpy as np

from .errors import InvalidArgument


def as_json(document: Any, field: str) -> str:
    """Write a document, with arrays and numbers of NumPy as Python's own. NaN is left for whoever reads it to refuse, by its field."""
    try:
        return json.dumps(document, default=_plain)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(f"it cannot travel as JSON: {error}", field) from error


def object_id(value: Any, field: str) -> int:
    """Take an object's id: a whole number, or one written out. What lies between two ids is refused, not rounded to one of them."""
    try:
        return int(value) if isinstance(value, str) else operator.index(value)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(f"expected an object id, a whole number, got {value!r}", field) from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"expected numbers, texts, lists and dictionaries, got {type(value).__name__}")
