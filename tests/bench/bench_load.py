"""The service under load: three live rigs, reads at a steady rate, and trouble on every side.

Phases: reads alone; then with a receiver of webhooks that never answers and a client of the event stream that
never reads; then with the store locked by another program as well. Latency counts from the moment at which a
request was due, so a service that falls behind cannot hide it. Beside it, in turn with it, a bare server is asked
that answers with fixed bytes: what the machine, the server's library and the client add by themselves is
``bare_p99_ms``.
"""

import argparse
import asyncio
import contextlib
import json
import math
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import two_masses
from receiver import receiving

_NAMES = ("north", "south", "west")
_PATHS = [
    path
    for name in _NAMES
    for path in (f"/rigs/{name}", f"/rigs/{name}/nodes", f"/rigs/{name}/history?limit=20", "/alarms", "/rigs")
]
_CONNECTIONS = 16
_BARE = """
import socket, uvicorn
BODY = b"x" * 2000
HEADERS = [(b"content-type", b"application/json"), (b"content-length", b"2000")]
async def app(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": HEADERS})
    await send({"type": "http.response.body", "body": BODY})
listener = socket.create_server(("127.0.0.1", 0))
print(listener.getsockname()[1], flush=True)
uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off")).run(sockets=[listener])
"""
_BARE_SHARE = 4  # one request of so many goes to the bare server as well


def service(directory, port, names=_NAMES, more=""):
    """Start a service with simulated rigs; lines of TOML may be added to their sources."""
    (directory / "model.toml").write_text(two_masses.model(cubic=1e10))
    text = ""
    for name in names:
        (directory / f"{name}.toml").write_text(two_masses.rig(name, samples=1024, transient=1))
        text += f'[[rigs]]\nrig = "{name}.toml"\nmodel = "model.toml"\nwindow = 2\n'
        text += '[rigs.source]\nkind = "simulated"\nrms = 20.0\nsteady_periods = 2\n' + more
    (directory / "creak.toml").write_text(text)
    environment = {**os.environ, "CREAK_SERVER__PORT": str(port), "CREAK_WEBHOOKS__ALLOW": '["127.0.0.0/8"]'}
    command = [sys.executable, "-m", "creak.cli", "serve", "creak.toml"]
    with open(directory / "log", "w") as log:
        return subprocess.Popen(command, cwd=directory, env=environment, stderr=log, stdout=log)


def end(process):
    """End a service as an operator would, for certain."""
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(20)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


async def _ask(port, reader, writer, path, method="GET", body=b""):
    head = f"{method} {path} HTTP/1.1\r\nhost: 127.0.0.1:{port}\r\ncontent-length: {len(body)}\r\n"
    writer.write(f"{head}content-type: application/json\r\n\r\n".encode() + body)
    answer = await reader.readuntil(b"\r\n\r\n")
    status = int(answer.split(b" ", 2)[1])
    length = next(int(line[15:]) for line in answer.lower().split(b"\r\n") if line.startswith(b"content-length:"))
    return status, await reader.readexactly(length)


async def _one(port, path, method="GET", body=b""):
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        status, text = await _ask(port, reader, writer, path, method, body)
        return status, json.loads(text)
    finally:
        writer.close()


async def _reads(port, bare, rate, seconds):
    """Ask at a steady rate; latencies in seconds, and answers that were not 200."""
    latencies, fixed, failures = [], [], 0
    begun = time.monotonic()

    async def client(port, rate, numbers, into):
        nonlocal failures
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for number in numbers:
            due = begun + number / rate
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            status, _ = await _ask(port, reader, writer, "/api/v1" + _PATHS[number % len(_PATHS)])
            into.append(time.monotonic() - due)
            failures += status != 200
        writer.close()

    share = rate / _BARE_SHARE
    wanted, beside = iter(range(round(rate * seconds))), iter(range(round(share * seconds)))
    await asyncio.gather(
        *(client(port, rate, wanted, latencies) for _ in range(_CONNECTIONS)),
        *(client(bare, share, beside, fixed) for _ in range(_CONNECTIONS // _BARE_SHARE)),
    )
    return {
        "requests": len(latencies),
        "per_second": round(len(latencies) / (time.monotonic() - begun), 1),
        "failures": failures,
        "p50_ms": _at(latencies, 0.5),
        "p99_ms": _at(latencies, 0.99),
        "max_ms": _at(latencies, 1.0),
        "bare_p50_ms": _at(fixed, 0.5),
        "bare_p99_ms": _at(fixed, 0.99),
        "bare_max_ms": _at(fixed, 1.0),
    }


def _at(seconds, share):
    return round(1000 * sorted(seconds)[math.ceil(share * len(seconds)) - 1], 1)


async def _rigs(port):
    _, document = await _one(port, "/api/v1/rigs")
    return {item["name"]: item for item in document["items"]}


@contextlib.asynccontextmanager
async def _stalled_stream(port):
    """A client of the event stream whose buffer is tiny and which never reads."""
    client = socket.socket()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    client.connect(("127.0.0.1", port))
    client.sendall(f"GET /api/v1/events HTTP/1.1\r\nhost: 127.0.0.1:{port}\r\nlast-event-id: 0\r\n\r\n".encode())
    try:
        yield
    finally:
        client.close()


def _lock(path, seconds):
    """Hold the store as a backup or an administrator would; in a thread, as it has to wait for the lock itself."""
    other = sqlite3.connect(path, isolation_level=None, timeout=30)
    other.execute("BEGIN IMMEDIATE")
    time.sleep(seconds)
    other.execute("ROLLBACK")
    other.close()


async def _measure(port, bare, directory, rate, seconds, blocked, stalled):
    result = {}
    end = time.monotonic() + 120
    while True:
        with contextlib.suppress(OSError):
            if (await _one(port, "/readyz"))[0] == 200:
                break
        if time.monotonic() > end:
            raise SystemExit((directory / "log").read_text())
        await asyncio.sleep(0.2)
    result["reads"] = await _reads(port, bare, rate, seconds)
    hook = json.dumps({"url": stalled.url}).encode()
    _, added = await _one(port, "/api/v1/webhooks", "POST", hook)
    await _one(port, f"/api/v1/webhooks/{added['id']}/test", "POST")  # so that there is something to stall
    async with _stalled_stream(port):
        result["stalled receiver and stream"] = await _reads(port, bare, rate, seconds)
        before = await _rigs(port)
        lock = asyncio.create_task(asyncio.to_thread(_lock, directory / "var" / "creak.db", blocked))
        result["and the store locked"] = await _reads(port, bare, rate, max(seconds, blocked + 5))
        await lock
    await asyncio.sleep(3)
    after = await _rigs(port)
    result["rigs"] = {
        name: {
            "frames": after[name]["frames"],
            "rejected_frames": after[name]["rejected_frames"],
            "faults": after[name]["faults"],
            "frames while locked": after[name]["frames"] - before[name]["frames"],
        }
        for name in after
    }
    result["webhook attempts"] = len(stalled.received)
    return result


def measure(rate=200.0, seconds=20.0, blocked=10.0):
    """Run all phases; figures of each, and what the rigs lost."""
    with tempfile.TemporaryDirectory() as name, receiving(*[("stall", {"seconds": 30})] * 1000) as stalled:
        directory = Path(name)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        process = service(directory, port)
        beside = subprocess.Popen([sys.executable, "-c", _BARE], stdout=subprocess.PIPE)
        try:
            bare = int(beside.stdout.readline())
            result = asyncio.run(_measure(port, bare, directory, rate, seconds, blocked, stalled))
            return {**result, "load average": [round(load, 2) for load in os.getloadavg()]}
        finally:
            beside.kill()
            beside.communicate()
            end(process)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=200.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = measure(options.rate, options.seconds)
    print(json.dumps(result, indent=None if options.json else 2))


if __name__ == "__main__":
    main()
