"""The live page's server under load, and its end."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import psutil
import pytest
from pages import answer, connected, port, refuses

from ffsms_pin.viewer.server import Server

pytestmark = pytest.mark.usefixtures("own_ports")


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.close()


def test_thousands_of_page_loads_block_nothing(server: Server) -> None:
    started = time.monotonic()
    for k in range(2_000):
        assert answer(server.url)[0] == 200
        if k % 20 == 0:
            connected(server.url).close()
            assert answer(server.url, path="/wrong/")[0] == 403
        server.check()
        server.scene.put("set_transform", "/a", "", b"command")
    assert time.monotonic() - started < 60.0


def test_idle_connections_are_bounded(server: Server) -> None:
    process = psutil.Process()
    mine = [socket.create_connection(("127.0.0.1", port(server.url)), timeout=10.0) for _ in range(200)]
    files = process.num_fds() if hasattr(process, "num_fds") else 0
    closed = 0
    for plug in mine[64:]:
        plug.settimeout(5.0)
        try:
            closed += plug.recv(1) == b""
        except ConnectionError:
            closed += 1
    assert closed == 200 - 64
    if files:
        assert process.num_fds() < files + 200
    for plug in mine:
        plug.close()
    time.sleep(0.3)
    assert answer(server.url)[0] == 200


def test_an_open_page_learns_of_the_end(server: Server) -> None:
    page = connected(server.url)
    server.close()
    page.settimeout(10.0)
    while page.recv(65536):
        pass
    page.close()


def test_a_program_ends_as_if_there_were_no_page() -> None:
    program = LONELY.replace("time.sleep(60)", "")
    started = time.monotonic()
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr == ""
    assert time.monotonic() - started < 30.0


LONELY = """
import sys, time
from ffsms_pin.viewer.server import Server
server = Server()
print(server.url, flush=True)
time.sleep(60)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_it_ends_with_its_process_however_that_ends() -> None:
    with subprocess.Popen([sys.executable, "-c", LONELY], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        page = connected(url)
        assert answer(url)[0] == 200
        assert psutil.Process(process.pid).children(recursive=True) == []  # so nothing can be left behind
        os.kill(process.pid, signal.SIGKILL)
        process.wait(timeout=10.0)
        assert refuses("127.0.0.1", port(url))
        page.close()


FULL = """
import resource, socket, sys, time, warnings
from ffsms_pin.errors import ViewerError
from ffsms_pin.viewer.server import Server
server = Server()
port = int(server.url.split(":")[2].split("/")[0])
time.sleep(0.5)  # its thread has what it needs
used = len(__import__("os").listdir("/proc/self/fd"))
resource.setrlimit(resource.RLIMIT_NOFILE, (used + 2, used + 2))
mine = []
try:
    while True:
        mine.append(socket.socket())
except OSError:
    pass
mine.pop().close()
plug = socket.create_connection(("127.0.0.1", port))
time.sleep(1.0)
try:
    server.check()
except ViewerError as error:
    print(error)
server.close()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
def test_without_free_files_it_ends_and_says_so_once() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FULL], capture_output=True, text=True, timeout=60, check=True
    )
    assert "has ended (Too many open files)" in done.stdout
    assert done.stderr == ""
