"""Hosts of their own on this machine: network namespaces on a bridge, and what runs in them."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest


class Hosts:
    """Hosts that reach each other by a network of their own.

    Attributes
    ----------
    addresses : list of str
        IP addresses of `host0`, `host1` ...
    """

    def __init__(self, count: int) -> None:
        self._name = f"gm{os.getpid() % 100_000}"
        self.addresses = [f"10.77.31.{host + 1}" for host in range(count)]
        self._processes: list[subprocess.Popen[str]] = []

    def namespace(self, host: int) -> str:
        return f"{self._name}h{host}"

    def build(self) -> None:
        _ip("link", "add", self._name, "type", "bridge")
        _ip("link", "set", self._name, "up")
        for host, address in enumerate(self.addresses):
            _ip("netns", "add", self.namespace(host))
            _ip("link", "add", self._cable(host), "type", "veth", "peer", "name", "eth0", "netns", self.namespace(host))
            _ip("link", "set", self._cable(host), "master", self._name, "up")
            _ip("-n", self.namespace(host), "addr", "add", f"{address}/24", "dev", "eth0")
            for device in ("eth0", "lo"):
                _ip("-n", self.namespace(host), "link", "set", device, "up")

    def start(
        self, host: int, *words: str, hidden: Path | None = None, folder: Path, variables: Mapping[str, str]
    ) -> subprocess.Popen[str]:
        """Start a program on a host that has its own name and sees an empty folder in place of the `hidden` one."""
        script = 'echo "$0" > /proc/sys/kernel/hostname; test -z "$1" || mount -t tmpfs none "$1"; shift; exec "$@"'
        own = ["unshare", "--mount", "--uts", "sh", "-c", script, f"host{host}", str(hidden or "")]
        process = subprocess.Popen(
            ["ip", "netns", "exec", self.namespace(host), *own, *words],
            env={**os.environ, **variables}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder,
        )  # fmt: skip
        self._processes.append(process)
        return process

    def cut(self, host: int) -> None:
        """Pull the cable of a host: nothing that is sent to it is answered any more."""
        _ip("link", "set", self._cable(host), "down")

    def remove(self) -> None:
        """End all that runs on the hosts, and remove them."""
        for host in range(len(self.addresses)):
            found = subprocess.run(["ip", "netns", "pids", self.namespace(host)], capture_output=True, text=True)
            for process in found.stdout.split():
                with suppress(ProcessLookupError):
                    os.kill(int(process), 9)
        for process in self._processes:
            process.kill()
            process.communicate()
        for host in range(len(self.addresses)):
            subprocess.run(["ip", "netns", "del", self.namespace(host)], capture_output=True)
        subprocess.run(["ip", "link", "del", self._name], capture_output=True)

    def _cable(self, host: int) -> str:
        return f"{self._name}v{host}"


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


@contextmanager
def hosts(count: int) -> Iterator[Hosts]:
    """Hosts for a test, which is skipped, with the reason, where they cannot be had."""
    if shutil.which("ip") is None or shutil.which("unshare") is None:
        pytest.skip("no hosts of their own: apt-get install iproute2 util-linux")
    made = Hosts(count)
    try:
        try:
            made.build()
        except subprocess.CalledProcessError as error:
            pytest.skip(f"hosts of their own need root and network namespaces: {error.stderr.strip()}")
        yield made
    finally:
        made.remove()
