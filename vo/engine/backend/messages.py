"""Messages between this process and a solver's: a mark, a length and a pickle, over pipes.

The pipes belong to the two processes alone, so that a pickle is safe. What a library prints into
one by mistake is recognised by the missing mark.
"""

from __future__ import annotations

import pickle
import struct
from typing import IO, Any

_HEADER = struct.Struct("<8sQ")
_MARK = b"vowindow"
_MAX_BYTES = 2**30


def send(pipe: IO[bytes], message: object) -> None:
    """Write a message.

    Raises:
        OSError: the other end is closed.
        ValueError: the message is too long.
    """
    data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    if len(data) > _MAX_BYTES:
        raise ValueError(f"a problem of {len(data)} bytes is too large")
    pipe.write(_HEADER.pack(_MARK, len(data)))
    pipe.write(data)
    pipe.flush()


def receive(pipe: IO[bytes]) -> Any:
    """Wait for a message.

    Raises:
        EOFError: the other end is closed.
        OSError: something else was received.
    """
    mark, length = _HEADER.unpack(_exactly(pipe, _HEADER.size))
    if mark != _MARK or length > _MAX_BYTES:
        raise OSError(f"received {mark!r} and a length of {length}, which is no message")
    return pickle.loads(_exactly(pipe, length))


def _exactly(pipe: IO[bytes], count: int) -> bytes:
    data = pipe.read(count)
    if len(data) < count:
        raise EOFError(f"received {len(data)} of {count} bytes")
    return data
