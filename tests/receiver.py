"""A receiver of webhooks on loopback, which answers as it is told and keeps what came."""

import contextlib
import json
import threading
import time
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass(frozen=True)
class Received:
    path: str
    headers: dict
    body: bytes
    at: float

    @property
    def id(self):
        return self.headers["webhook-id"]

    @property
    def json(self):
        return json.loads(self.body)


class ReceiverServer(ThreadingHTTPServer):
    """``answers`` are taken one by one, then 204 for ever: a status, or status and headers, or seconds to wait.

    The status "early" is a 204 with a 103 before it.
    """

    daemon_threads = True

    def __init__(self, answers=(), tls=None):
        super().__init__(("127.0.0.1", 0), _Handler)
        if tls is not None:
            self.socket = tls.wrap_socket(self.socket, server_side=True)
        self.answers = list(answers)
        self.received = []
        self.default = 204
        self.lock = threading.Lock()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}/hook"

    def handle_error(self, request, client_address):
        pass  # a deliverer that breaks off is what some tests are about

    def wait(self, count, seconds=30.0):
        """The first ``count`` requests."""
        end = time.monotonic() + seconds
        while len(self.received) < count:
            assert time.monotonic() < end, f"{len(self.received)} of {count} requests came"
            time.sleep(0.01)
        return self.received[:count]


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        server = self.server
        length = int(self.headers["content-length"])
        body = self.rfile.read(length)
        if len(body) < length:  # the sender was killed in the middle: nothing has arrived
            self.close_connection = True
            return
        with server.lock:
            headers = {name.lower(): value for name, value in self.headers.items()}
            server.received.append(Received(self.path, headers, body, time.monotonic()))
            answer = server.answers.pop(0) if server.answers else server.default
        status, headers = answer if isinstance(answer, tuple) else (answer, {})
        if status == "stall":
            time.sleep(headers["seconds"])
            return
        if status == "early":
            self.wfile.write(b"HTTP/1.1 103 Early Hints\r\nLink: </style.css>\r\n\r\n")
            status = 204
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("content-length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass


@contextlib.contextmanager
def receiving(*answers, tls=None):
    server = ReceiverServer(answers, tls)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
