"""Requests as calls of functions, and their results as answers."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from anyio import CapacityLimiter, to_thread
from pydantic import BaseModel, ValidationError
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from vamgpu.errors import BadInput, JobError, MeshError, StorageError, VamError
from vamgpu.storage.reading import MOST_TOML, parse_json
from vamgpu.studio.requests import Nothing
from vamgpu.studio.volumes import Arrays
from vamgpu.studio.workspace import Refused

SILENCE = 10.0  # longest pause between two pieces of a body [s]
SLOWEST = 30.0  # longest time for a JSON body [s]
THREADS = 16
"""Largest number of handlers at a time, in threads of their own; those of the print page's buttons stay free."""
JSON = "application/json"
Handler = Callable[..., Any]


def refused(status: int, message: str, fields: list[dict[str, Any]] | None = None) -> Response:
    """An answer that names what is wrong."""
    return JSONResponse({"error": {"message": message, "fields": fields or []}}, status)


def explained(error: BaseException) -> Response:
    """The answer to a request that raised an error."""
    if isinstance(error, ValidationError):
        found = [(".".join(str(part) for part in each["loc"]), each["msg"]) for each in error.errors()[:20]]
        said = "; ".join(f"{field or 'the body'}: {message}" for field, message in found)
        return refused(400, f"{said}: correct the request", [{"field": field, "line": None, "message": message}
                                                            for field, message in found])  # fmt: skip
    if isinstance(error, (JobError, Refused)):
        fields = [{"field": each.key, "line": each.line, "message": each.message} for each in error.wrong]
        return refused(error.status if isinstance(error, Refused) else 400, str(error), fields)
    if isinstance(error, MemoryError):
        return refused(503, "this machine's memory is used up; close other programs, and try again")
    if isinstance(error, OSError) and not isinstance(error, StorageError):
        return refused(422, f"{error.strerror or error}; check the disk, and reload the list")
    if not isinstance(error, VamError):
        return refused(422, f"what was asked for is damaged ({type(error).__name__}: {error}); write it again")
    bad = isinstance(error, BadInput) and not isinstance(error, MeshError)
    return refused(400 if bad else 422, str(error))


async def pieces(request: Request, most: int) -> AsyncIterator[bytes]:
    """The body, piece by piece. Raises `Refused` if it is too large, or comes too slowly."""
    length, got = request.headers.get("content-length"), 0
    if length is not None and (not length.isdecimal() or int(length) > most):
        raise Refused(413, f"got a body of {length[:20]} bytes; expected {most:,} at most")
    stream = request.stream()
    while True:
        try:
            piece = await asyncio.wait_for(anext(stream), SILENCE)
        except StopAsyncIteration:
            return
        except TimeoutError as error:
            raise Refused(408, f"the body stopped for {SILENCE:g} s; send it again") from error
        got += len(piece)
        if got > most:
            raise Refused(413, f"got more than {most:,} bytes; expected {most:,} at most")
        yield piece


async def _body(request: Request, model: type[BaseModel]) -> BaseModel:
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != JSON:
        raise Refused(415, f"expected a body of type {JSON}")
    try:
        async with asyncio.timeout(SLOWEST):
            data = b"".join([piece async for piece in pieces(request, MOST_TOML)])
    except TimeoutError as error:
        raise Refused(408, f"the body took longer than {SLOWEST:g} s; send it again") from error
    try:
        given = parse_json(data)
    except ValueError as error:
        raise Refused(400, f"the body is not JSON: {error}; correct it") from error
    return model.model_validate(given)


def answer(
    handler: Handler, body: type[BaseModel] | None = None, query: type[BaseModel] = Nothing, status: int = 200
) -> Callable[[Request], Awaitable[Response]]:
    """An endpoint that calls a function in a thread with names of the path, the query and the body."""

    async def endpoint(request: Request) -> Response:
        try:
            pairs = request.query_params.multi_items()
            if len(dict(pairs)) != len(pairs):
                raise Refused(400, "a key of the query is there twice; give it once")
            given: dict[str, Any] = dict(request.path_params)
            asked = query.model_validate(dict(pairs))
            given |= {name: getattr(asked, name) for name in type(asked).model_fields}
            if body is not None:
                given["body"] = await _body(request, body)
            state = request.app.state
            state.limiter = state.limiter or CapacityLimiter(THREADS)
            return _answered(await to_thread.run_sync(lambda: handler(**given), limiter=state.limiter), status)
        except ClientDisconnect:
            return Response(status_code=400)
        except (VamError, ValueError, MemoryError, OSError, LookupError, TypeError, AttributeError) as error:
            return explained(error)  # the last three: a folder of another version, or a damaged one

    return endpoint


def _answered(found: Any, status: int) -> Response:
    if isinstance(found, Response):
        return found
    if isinstance(found, Arrays):
        data, headers = found.body()
        return Response(data, status, headers, "application/octet-stream")
    return JSONResponse({} if found is None else found, status)
