"""HTTP for live streams, which stays on the host that was given.

A camera that was taken over could lead this machine by a redirect or a playlist to addresses that
only it can reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from http.client import HTTPException
from typing import Any
from urllib.error import URLError
from urllib.parse import urlsplit, urlunsplit
from urllib.request import (
    HTTPBasicAuthHandler,
    HTTPDigestAuthHandler,
    HTTPPasswordMgrWithDefaultRealm,
    HTTPRedirectHandler,
    Request,
    build_opener,
)

from vo.base.errors import SourceError
from vo.recordings.sources.live.address import without_credentials

_MULTIPART = "multipart/"


class HttpHosts:
    """Opens addresses of a stream on the host of the first one, or on hosts that are allowed.

    `allowed`: names of further hosts.
    """

    def __init__(self, url: str, allowed: Sequence[str], timeout_s: float) -> None:
        parts = urlsplit(url)
        self._hosts = {(parts.hostname or "").lower(), *(host.lower() for host in allowed)}
        self._timeout_s = timeout_s
        passwords = HTTPPasswordMgrWithDefaultRealm()
        if parts.username:
            root = urlunsplit((parts.scheme, _host_and_port(url), "/", "", ""))
            passwords.add_password(None, root, parts.username, parts.password or "")
        handlers = (HTTPBasicAuthHandler(passwords), HTTPDigestAuthHandler(passwords))
        self._opener = build_opener(_Redirects(self), *handlers)

    def open(self, url: str, *_: object) -> HttpFile:
        """A file of an address; the other arguments are those of PyAV's `io_open`.

        Raises:
            SourceError: it is on another host.
            OSError: it cannot be opened.
        """
        self.check(url)
        parts = urlsplit(url)
        plain = urlunsplit((parts.scheme, _host_and_port(url), parts.path, parts.query, ""))
        try:
            return HttpFile(self._opener.open(Request(plain), timeout=self._timeout_s))
        except HTTPException as error:
            raise OSError(f"no answer of HTTP ({error})") from error
        except URLError as error:
            raise OSError(str(error.reason or error)) from error

    def check(self, url: str) -> None:
        """Refuse an address elsewhere.

        Raises:
            SourceError: it is on another host, or no HTTP.
        """
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or (parts.hostname or "") not in self._hosts:
            raise SourceError(
                f"the stream leads to {without_credentials(url)[:200]}, on another host than its "
                f"own; `allow_hosts={parts.hostname}` lets it go there"
            )


class HttpFile:
    """The bytes of an answer as they come, for PyAV."""

    def __init__(self, response: Any) -> None:
        self._response = response
        self.name: str = response.url
        is_multipart = response.headers.get_content_type().startswith(_MULTIPART)
        self.format = "mpjpeg" if is_multipart else None

    def read(self, count: int = -1) -> bytes:
        """At least one byte, at most so many, and none at the end."""
        return bytes(self._response.read1(count))

    def close(self) -> None:
        """End the connection."""
        self._response.close()


class _Redirects(HTTPRedirectHandler):
    def __init__(self, hosts: HttpHosts) -> None:
        self._hosts = hosts

    def redirect_request(self, *given: Any) -> Request | None:
        """See `HTTPRedirectHandler`: the last argument is the new address."""
        self._hosts.check(given[-1])
        return super().redirect_request(*given)


def _host_and_port(url: str) -> str:
    return urlsplit(url).netloc.rpartition("@")[2]
