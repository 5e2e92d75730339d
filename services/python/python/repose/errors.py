"""The errors of Repose: every one has a code, and names the field at fault where there is one."""

from __future__ import annotations

__all__ = [
    "Cancelled",
    "DeadlineExceeded",
    "FailedPrecondition",
    "InternalError",
    "InvalidArgument",
    "NotFound",
    "ReposeError",
    "ResourceExhausted",
    "Unavailable",
    "Unclear",
]


class ReposeError(Exception):
    """A request that could not be answered. That nothing was found is an answer, not an error.

    Attributes:
        code: ``invalid_argument``, ``not_found``, ``resource_exhausted``, ``deadline_exceeded``, ``cancelled``, ``unavailable``,
            ``failed_precondition`` or ``internal``.
        message: What was expected and what came.
        field: The request's field at fault, a dotted path; ``None`` where there is none.
        retryable: Whether the same call may be tried again.
        retry_after_ms: How long to wait before that, milliseconds; ``None`` where nobody knows.

    """

    code: str = "internal"

    def __init__(self, message: str, field: str | None = None, *, retryable: bool = False, retry_after_ms: int | None = None) -> None:
        super().__init__(message if field is None else f"{field}: {message}")
        self.message = message
        self.field = field
        self.retryable = retryable
        self.retry_after_ms = retry_after_ms


class InvalidArgument(ReposeError, ValueError):
    """A value that cannot be used."""

    code = "invalid_argument"


class Unclear(InvalidArgument):
    """A sentence that means nothing that can be planned, or more than one thing.

    Attributes:
        candidates: Ids of the objects in question.

    """

    def __init__(self, message: str, candidates: list[int]) -> None:
        super().__init__(message, "say")
        self.candidates = candidates

    def __reduce__(self) -> tuple[type[Unclear], tuple[str, list[int]]]:
        # Another process makes an exception of its arguments: here these.
        return Unclear, (self.message, self.candidates)


class NotFound(ReposeError, LookupError):
    """A scene or an object that is not there."""

    code = "not_found"


class ResourceExhausted(ReposeError):
    """A full queue; another worker, or a later try, may do."""

    code = "resource_exhausted"


class DeadlineExceeded(ReposeError, TimeoutError):
    """The deadline passed before the work was done."""

    code = "deadline_exceeded"


class Cancelled(ReposeError):
    """The caller cancelled."""

    code = "cancelled"


class Unavailable(ReposeError, ConnectionError):
    """Nobody answers: no worker alive, or no way to it."""

    code = "unavailable"


class FailedPrecondition(ReposeError):
    """The world is not in the state that the request needs."""

    code = "failed_precondition"


class InternalError(ReposeError):
    """A defect on Repose's side."""

    code = "internal"


_BY_CODE: dict[str, type[ReposeError]] = {
    kind.code: kind
    for kind in (InvalidArgument, NotFound, ResourceExhausted, DeadlineExceeded, Cancelled, Unavailable, FailedPrecondition, InternalError)
}


def error_of(code: str, message: str, field: str | None, retryable: bool, retry_after_ms: int | None) -> ReposeError:
    """Make the exception for an error reply."""
    kind = _BY_CODE.get(code, InternalError)
    return kind(message, field, retryable=retryable, retry_after_ms=retry_after_ms)
