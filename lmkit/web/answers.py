"""Request bodies with size limits and checked values; JSON responses, with errors and their hints."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from lmkit.errors import InputError, LmkitError, NegativeAnswer
from lmkit.io.field_problems import first_problem

MAX_JSON = 1024 * 1024
MAX_UPLOAD = 64 * 1024 * 1024
Handler = Callable[[Request], Awaitable[Response]]
# Error codes that have a status of their own.
STATUS = {"no_file": 404, "no_job": 404, "too_large": 413, "changed": 409, "busy": 503, "too_slow": 503}


class Body(BaseModel):
    """Base of request bodies: unknown keys and values that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


BodyT = TypeVar("BodyT", bound=Body)


async def read_bytes(request: Request, most: int) -> bytes:
    """The body of a request.

    Raises:
        InputError: more than ``most`` bytes.
    """
    parts, size = [], 0
    async for part in request.stream():
        size += len(part)
        if size > most:
            raise InputError("too_large", f"more than {most >> 20} MiB", "send a smaller file")
        parts.append(part)
    return b"".join(parts)


async def read_body(request: Request, layout: type[BodyT]) -> BodyT:
    """The body of a request as JSON.

    Raises:
        InputError: not JSON, or not of this layout; names the key.
    """
    data = await read_bytes(request, MAX_JSON)
    try:
        return layout.model_validate_json(data or b"{}")
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_value", f"{where}: {problem}", "correct that value") from None


def answer(data: Any) -> JSONResponse:
    """JSON of a result."""
    return JSONResponse(data)


def guarded(handler: Handler) -> Handler:
    """The handler, with failures as JSON: code, message, hint."""

    async def run(request: Request) -> Response:
        try:
            return await handler(request)
        except NegativeAnswer as error:
            return JSONResponse(error.as_dict(), 422)
        except LmkitError as error:
            return JSONResponse(error.as_dict(), STATUS.get(error.code, 400))
        except Exception as error:
            traceback.print_exc(file=sys.stderr)
            problem = f"internal error: {type(error).__name__}"
            hint = "please report it with the traceback in the terminal"
            return JSONResponse({"code": "internal", "message": problem, "hint": hint}, 500)

    return run
