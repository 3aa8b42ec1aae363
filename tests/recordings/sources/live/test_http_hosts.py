"""HTTP streams that lead to other hosts."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from vo.base.errors import SourceError
from vo.recordings.sources.live.clock import HostClock
from vo.recordings.sources.live.http_stream import HttpHosts
from vo.recordings.sources.live.pyav_device import PyAvStream


class _Answers(BaseHTTPRequestHandler):
    """Paths: `/to/HOST` redirects, `/list/HOST/v.m3u8` is a playlist, all others are text."""

    def do_GET(self) -> None:
        word, host, *_ = *self.path[1:].split("/"), ""
        target = f"http://{host}:{self.server.server_address[1]}/x.ts"
        self.server.asked.append((self.headers["Host"].partition(":")[0], word))  # type: ignore[attr-defined]
        self.send_response(302 if word == "to" else 200)
        if word == "to":
            self.send_header("Location", target)
        self.end_headers()
        if word == "list":
            self.wfile.write(
                f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{target}\n#EXT-X-ENDLIST\n".encode()
            )
        self.wfile.write(b"text")

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[ThreadingHTTPServer]:
    with ThreadingHTTPServer(("127.0.0.1", 0), _Answers) as server:
        server.asked = []  # type: ignore[attr-defined]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


@pytest.mark.parametrize("word", ["to", "list"])
def test_another_host_is_refused_and_never_asked(server: ThreadingHTTPServer, word: str) -> None:
    url = f"http://127.0.0.1:{server.server_address[1]}/{word}/localhost/v.m3u8"
    with pytest.raises(SourceError, match=r"(`allow_hosts=localhost`|cannot be opened)"):
        PyAvStream(url, HostClock())
    assert {host for host, _ in server.asked} == {"127.0.0.1"}  # type: ignore[attr-defined]
    with pytest.raises(SourceError, match="cannot be opened"):  # it is asked, and gives text
        PyAvStream(url, HostClock(), ["localhost"])
    assert ("localhost", "x.ts") in server.asked  # type: ignore[attr-defined]


def test_a_redirect_on_the_same_host_is_followed(server: ThreadingHTTPServer) -> None:
    url = f"http://127.0.0.1:{server.server_address[1]}/to/127.0.0.1"
    assert HttpHosts(url, (), 5.0).open(url).read(4) == b"text"


@pytest.mark.parametrize("url", ["file:///etc/passwd", "ftp://127.0.0.1/x", "http://other/x"])
def test_other_addresses_are_refused(url: str) -> None:
    with pytest.raises(SourceError, match="on another host"):
        HttpHosts("http://127.0.0.1/x", (), 5.0).open(url)
