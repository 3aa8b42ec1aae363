"""Runs a command on a Ray cluster of several nodes on this machine.

    scripts/ray_cluster --nodes 2 --cpus 1 -- vo batch recordings/ -o out --ray auto

`--ray auto` of the command finds the cluster by RAY_ADDRESS. Each node is a `ray start` of its own.
"""

from __future__ import annotations

import argparse
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

_RAY = [sys.executable, "-m", "ray.scripts.scripts"]
_NO_DASHBOARD = "--include-dashboard=false"
_START_S = 60.0


@dataclass(frozen=True)
class Cluster:
    """Nodes of a cluster, of which the first is the head."""

    address: str  # for `ray.init` and RAY_ADDRESS
    environment: dict[str, str]  # variables for programs that use it: address and token
    nodes: tuple[subprocess.Popen[bytes], ...]  # processes of `ray start --block`

    def kill(self, number: int) -> None:
        """End a node at once, as if its machine had lost its power."""
        process = self.nodes[number]
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@contextmanager
def cluster(nodes: int, cpus: int) -> Iterator[Cluster]:
    """A cluster of nodes with some logical CPUs each, ended with the context."""
    address = f"127.0.0.1:{_free_port()}"
    folder = tempfile.mkdtemp(prefix="vo-ray-", dir="/tmp")  # sockets need a short path
    token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    environment = {**os.environ, **token, "RAY_ADDRESS": address}
    started: list[subprocess.Popen[bytes]] = []
    try:
        for number in range(nodes):
            port = address.rpartition(":")[2]
            head = ["--head", f"--port={port}", f"--temp-dir={folder}", _NO_DASHBOARD]
            where = head if number == 0 else [f"--address={address}"]
            started.append(_start([*where, f"--num-cpus={cpus}"], folder, number, token))
            _wait_for(address, number + 1, started[-1], os.path.join(folder, f"{number}.log"))
        yield Cluster(address, environment, tuple(started))
    finally:
        for process in reversed(started):
            process.terminate()
        for process in started:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        shutil.rmtree(folder, ignore_errors=True)


def _start(
    words: list[str], folder: str, number: int, token: dict[str, str]
) -> subprocess.Popen[bytes]:
    options = ["--block", "--disable-usage-stats"]
    options += [f"--object-store-memory={100 << 20}", f"--memory={4 << 30}"]
    with open(os.path.join(folder, f"{number}.log"), "wb") as log:
        return subprocess.Popen(
            [*_RAY, "start", *words, *options],
            env={**os.environ, **token},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )


def _wait_for(address: str, nodes: int, process: subprocess.Popen[bytes], log: str) -> None:
    """Wait until `ray start` says that its node runs."""
    end = time.monotonic() + _START_S
    while time.monotonic() < end:
        with open(log, encoding="utf-8", errors="replace") as stream:
            text = stream.read()
        if "Ray runtime started" in text:
            return
        if process.poll() is not None:
            break
        time.sleep(0.1)
    raise SystemExit(f"error: node {nodes} of {address} did not start: {text[-500:]}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    """Start the cluster, run the command, end the cluster; exit with its status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nodes", type=int, default=2)
    parser.add_argument("--cpus", type=int, default=1, help="logical CPUs of each node")
    parser.add_argument(
        "--kill-after", type=float, metavar="S", help="kill the last node after this time"
    )
    parser.add_argument("command", nargs="+")
    arguments = parser.parse_args()
    with cluster(arguments.nodes, arguments.cpus) as running:
        process = subprocess.Popen(arguments.command, env=running.environment)
        if arguments.kill_after is not None:
            try:
                process.wait(arguments.kill_after)
            except subprocess.TimeoutExpired:
                running.kill(-1)
        status = process.wait()
    raise SystemExit(status)


if __name__ == "__main__":
    main()
