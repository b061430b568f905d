"""Where a message goes: to the address that was checked, under the name that was given, and nowhere else."""

import contextlib
import socket
import ssl
import threading
from datetime import UTC, datetime, timedelta

import pytest
import trustme
from standardwebhooks import Webhook

from creak.sinks.database import open_store
from creak.webhooks.addresses import AddressPolicy
from creak.webhooks.delivery import DeliveryRules
from creak.webhooks.schedule import Schedule
from processes import wait_for
from receiver import receiving
from store_records import make_alarm, opened
from webhook_desk import FAST, RUN, add, delivering, log, statuses

PATIENT = DeliveryRules(schedule=FAST, timeout=5.0)


@pytest.fixture
def store(tmp_path):
    made = open_store(f"sqlite:///{tmp_path}/creak.db")
    yield made
    made.close()


@pytest.fixture
def sink(store):
    return opened(store, RUN)


def test_redirect_is_not_followed(store, sink):
    """Kills the way around the address check."""
    with receiving() as inside, receiving(*[(307, {"Location": inside.url})] * 5) as server, delivering(store):
        add(store, server.url)
        sink.take(make_alarm(RUN))
        wait_for(lambda: statuses(store) == ["failed"])
        assert inside.received == []


def test_what_a_receiver_says_before_its_answer_is_no_answer(store, sink):
    """Kills a delivery that counts as failed, and is made again, since a 103 came before its 204."""
    with receiving("early") as server, delivering(store, rules=PATIENT):
        receiver = add(store, server.url)
        sink.take(make_alarm(RUN))
        wait_for(lambda: statuses(store) == ["delivered"])
        assert [entry["status_code"] for entry in log(store, receiver)] == [204]


def test_proxy_of_the_environment_is_not_asked(store, sink, monkeypatch):
    with receiving() as proxy, receiving() as server:
        for name in ("http_proxy", "HTTP_PROXY", "ALL_PROXY", "https_proxy"):
            monkeypatch.setenv(name, proxy.url)
        with delivering(store):
            add(store, server.url)
            sink.take(make_alarm(RUN))
            server.wait(1)
        assert proxy.received == []


def test_rebinding_name_gets_no_connection(store, sink):
    """A name that is public when it is checked and loopback when it is used; it is looked up once an attempt."""
    asked = []

    async def rebinding(host, port):
        asked.append(host)
        return ["93.184.215.14"] if len(asked) == 1 else ["127.0.0.1"]

    with receiving() as server:
        receiver = add(store, f"http://rebind.example:{server.server_port}/")
        with delivering(store, policy=AddressPolicy(), resolver=rebinding):
            sink.take(make_alarm(RUN))
            wait_for(lambda: statuses(store) == ["failed"])
        assert server.received == []
    entries = log(store, receiver)
    assert len(asked) == len(entries)
    assert all("127.0.0.1 is not a public address" in entry["error"] for entry in entries[1:])


def test_connection_goes_to_the_checked_address_with_the_name_in_the_host_header(store, sink):
    async def resolver(host, port):
        return ["127.0.0.1"]

    with receiving() as server:
        add(store, f"http://hook.example:{server.server_port}/a?b")
        with delivering(store, resolver=resolver):
            sink.take(make_alarm(RUN))
            (got,) = server.wait(1)
    assert (got.path, got.headers["host"]) == ("/a?b", f"hook.example:{server.server_port}")


@pytest.mark.parametrize(
    "trickle",
    [b"HTTP/1.1 200 OK\r\nx: ", b"not http at all\r\n\r\n", b"", b"HTTP/1.1 200 OK\r\n" + b"a: b\r\n" * 9000],
)
def test_odd_answers_end_in_time_and_take_no_memory(store, sink, trickle):
    """An answer without end, one that is not HTTP, none, and one of endless headers."""
    done = threading.Event()

    def answer(listener):
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listener.accept()
                with connection, contextlib.suppress(OSError):
                    connection.sendall(trickle)
                    while trickle.endswith(b": ") and not done.wait(0.05):
                        connection.sendall(b"y")

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=answer, args=(listener,), daemon=True).start()
        receiver = add(store, f"http://127.0.0.1:{listener.getsockname()[1]}/")
        with delivering(store, rules=DeliveryRules(timeout=0.2, schedule=Schedule(delays=()))):
            sink.take(make_alarm(RUN))
            wait_for(lambda: statuses(store) == ["failed"])
        done.set()
        listener.shutdown(socket.SHUT_RDWR)
    (entry,) = log(store, receiver)
    assert entry["status_code"] is None
    assert entry["seconds"] < 2
    assert entry["error"]


# --- TLS ---------------------------------------------------------------------------------------------------------

NAME = "hook.example"


@pytest.fixture
def authority(monkeypatch, tmp_path):
    """A certificate authority that the operating system trusts, as far as this process can see."""
    made = trustme.CA()
    made.cert_pem.write_to_path(tmp_path / "authority.pem")
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "authority.pem"))
    return made


async def at_home(host, port):
    return ["127.0.0.1"]


def secured(certificate, names):
    """The TLS of a receiver; what clients call it is noted."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    certificate.configure_cert(context)
    context.sni_callback = lambda _socket, name, _context: names.append(name)
    return context


def test_tls_asks_the_checked_address_for_the_name_and_believes_its_certificate(store, sink, authority):
    """Kills a certificate that is held against the address, and a name that is not told to the server."""
    names = []
    with receiving(tls=secured(authority.issue_cert(NAME), names)) as server:
        receiver = add(store, f"https://{NAME}:{server.server_port}/hook")
        with delivering(store, resolver=at_home, rules=PATIENT):
            sink.take(make_alarm(RUN))
            (got,) = server.wait(1)
            wait_for(lambda: statuses(store) == ["delivered"])
    assert names == [NAME]
    assert got.headers["host"] == f"{NAME}:{server.server_port}"
    assert Webhook(receiver.secret).verify(got.body, got.headers) == got.json


def test_tls_to_an_address_believes_a_certificate_of_that_address(store, sink, authority):
    with receiving(tls=secured(authority.issue_cert("127.0.0.1"), [])) as server:
        add(store, f"https://127.0.0.1:{server.server_port}/")
        with delivering(store, rules=PATIENT):
            sink.take(make_alarm(RUN))
            server.wait(1)
            wait_for(lambda: statuses(store) == ["delivered"])


YESTERDAY = datetime.now(UTC) - timedelta(days=1)
UNTRUSTED = {
    "of another name": lambda ca: ca.issue_cert("other.example"),
    "of the address only": lambda ca: ca.issue_cert("127.0.0.1"),
    "of a name below": lambda ca: ca.issue_cert(f"*.{NAME}"),
    "of another authority": lambda _: trustme.CA().issue_cert(NAME),
    "run out": lambda ca: ca.issue_cert(NAME, not_after=YESTERDAY, not_before=YESTERDAY - timedelta(days=9)),
}


@pytest.mark.parametrize("why", UNTRUSTED)
def test_certificate_that_proves_nothing_gets_no_message(store, sink, authority, why):
    """Kills a signed alarm, secret or not, that goes to whoever sits at the address."""
    with receiving(tls=secured(UNTRUSTED[why](authority), [])) as server:
        receiver = add(store, f"https://{NAME}:{server.server_port}/")
        once = DeliveryRules(timeout=5.0, schedule=Schedule(delays=()))
        with delivering(store, resolver=at_home, rules=once):
            sink.take(make_alarm(RUN))
            wait_for(lambda: statuses(store) == ["failed"])
        assert server.received == []
    (entry,) = log(store, receiver)
    assert entry["error"].startswith("TLS: ")
    assert "certificate" in entry["error"].lower()


def test_plain_answer_where_tls_was_asked_for_is_a_failure(store, sink):
    with receiving() as server:
        receiver = add(store, f"https://127.0.0.1:{server.server_port}/")
        with delivering(store, rules=DeliveryRules(timeout=5.0, schedule=Schedule(delays=()))):
            sink.take(make_alarm(RUN))
            wait_for(lambda: statuses(store) == ["failed"])
        assert server.received == []
    assert log(store, receiver)[0]["error"].startswith("TLS: ")
